"""The paper's Fig. 7 and 8: two walkers who stop before the robot does."""

import sys

from experiments.common import Options, main
from experiments.paper import walkers_experiment


def experiment(options: Options) -> None:
    """Map, trajectory and the walkers' positions for icp, docpfo and graph."""
    name = "paper_two_walkers"
    walkers_experiment(
        name, "Two walkers who stop before the robot does (the paper's Fig. 7 and 8)", "two-walkers", options
    )


if __name__ == "__main__":
    sys.exit(main(experiment))
