"""Models for other tools.

`targets` lists them, each a `write(subject, path)` of a `subject`: FMU (`fmu`, its XML in `description`), C
(`c_source`), state space (`state_space`), ONNX (`onnx_graph`), table (`parameter_table`). `signal_path` is what acts on
records, sample by sample; `compiler` builds libraries; `fmu_run` flies an FMU. C that all models share is in runtime/.
"""
