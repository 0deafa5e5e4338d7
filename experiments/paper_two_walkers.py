"""The paper's Fig. 7 and 8: two walkers who stop before the robot does."""

import sys

from experiments.common import Options, main
from experiments.paper import walkers_experiment


def experiment(options: Options) -> None:
    """Map, trajectory and the walkers' positions for icp, docpfo and graph."""
    name = "paper_two_walkers"
    caption = (
        ", the paper's Fig. 8 d: both walk until they stop for good after 60% of the drive, from where on their lines"
        " are level, but for a step out of the robot's way, and those detected end (the paper's Fig. 7: a to c,"
        " Fig. 8: d to i)."
    )
    title = "Two walkers who stop before the robot does (the paper's Fig. 7 and 8)"
    walkers_experiment(name, title, "two-walkers", caption, options)


if __name__ == "__main__":
    sys.exit(main(experiment))
