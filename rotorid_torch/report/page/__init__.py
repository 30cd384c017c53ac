"""The page of a run: one file that needs nothing else, neither files beside it nor a network.

`facts` is what a page knows of a model besides its report; `svg` draws what prints and follows the reader's colours,
`pictures` the pictures of a report with it; `plots` packs flights for the plots that readers zoom; `tables` arranges
derivatives, modes, parameters and evidence; `document` puts the page together from `templates/`, `check_page` that of a
check. What `static/` holds goes into every page; uPlot in it is by Leon Sorokin, under the MIT licence beside it.
"""
