"""Studies: logs or scenarios x methods x overrides x seeds, in cells that are computed once, here or on many machines.

`cells` says what a cell is and how it is addressed, `store` keeps the finished ones, `runner` computes the others on
`processes` or `dask_workers`; `study_file` reads a study's TOML, `plan` makes its cells, `measures` computes one,
`results` and `report` write tables, figures and a page.
May import `core`, `logs`, `mapping`, `simulation`, `evaluation`, `baselines` (its configuration), `methods`,
`pipeline_config`, `run`, `run_folder` (trajectories) and `viz`.
"""
