"""What each word of a report means, in one or two sentences; the page shows them on hover and as a list."""

GLOSSARY = {
    "free run": "The model starts from the flight's first second, is given the measured controls and nothing else, and"
    " flies for 8 s. No measurement corrects it on the way.",
    "J": "Error of a free run over what the channels usually move: root mean square over the channels u v w p q r phi"
    " theta. 0 is perfect; 1 is about as bad as a model that stays where it is.",
    "noise alone": "The score J that a perfect model would have, because the sensors themselves are noisy.",
    "holding trim": "The score J of assuming that the vehicle does nothing: channels stay at their first half second.",
    "explained": "Share of the squared motion that the model describes, the sensors' noise taken out:"
    " 1 - (J² - J_noise²) / (J_trim² - J_noise²).",
    "identify flight": "A flight that the model was made from.",
    "validate flight": "A flight that the model has not been made from, and that judges it.",
    "acid flight": "A flight that was never used to choose anything: neither parameters nor structure nor effects.",
    "R²": "1 is a perfect channel, 0 no better than its mean. It means little where an axis hardly moves.",
    "Theil": "Error over the size of both records, 0 to 1. Its parts say what the error is: offset (trim, bias),"
    " amplitude (gains), shape (delay, missing dynamics, gusts).",
    "windows": "J of all 8-s windows of a flight, one begun each second: the median, and where four of five lie.",
    "evidence": "How much better flights are predicted with an effect, its size estimated from other flights.",
    "floor": "The critical value: 95 % of vehicles with nothing missing show less evidence than this, over all effects"
    " together. The p beside it decides.",
    "p": "Share of vehicles with nothing missing that show as much evidence, over the whole procedure.",
    "smallest visible": "The size of an effect that these flights would show in 80 % of cases. A dash: no size that is"
    " possible, or nothing that was asked.",
    "standard error": "What repeated flights would scatter by: two thirds lie within one, 19 of 20 within two.",
    "band": "Two standard deviations to either side: of a measurement by its sensor's noise, of the model by the errors"
    " of its parameters. Wide although the model fits: flights leave derivatives of that axis open.",
    "residual": "Measured minus model: what the model does not describe.",
    "frozen": "A parameter that was held at a value from elsewhere.",
    "not identifiable": "A parameter that these flights cannot tell, and that was therefore held.",
    "at bound": "A value that stands on the end of its permitted range: it is the bound's, not the data's.",
    "undeclared effect": "Physics that acts on the vehicle and is not in what dataset.toml declares.",
    "clean aircraft": "Drawn aircraft like this one with nothing missing: what they show by chance sets the floor.",
    "at measured states": "The model is evaluated at the measured states and commands, nothing is integrated: what a"
    " multirotor's model is judged by, because its free runs drift whatever the model.",
    "modes": "Motions of the linearised model, named by the states that take part most. Oscillations: phugoid"
    " (u theta), short period (w q), lateral (v p r phi). Others bear the name of their state.",
    "time to half": "How long a mode takes to fall to half, or where it is unstable to grow to double.",
    "damping": "1 and more: no oscillation. 0: an oscillation that stays. Below 0: one that grows.",
}
