"""The paper's Fig. 5 and 6: one walker."""

import sys

from experiments.common import Options, main
from experiments.paper import walkers_experiment


def experiment(options: Options) -> None:
    """One walker in the lab: map, trajectory and the walkers' positions for icp, docpfo and graph."""
    name = "paper_one_walker"
    caption = ": one line for each walk past the robot (the paper's Fig. 5: a to c, Fig. 6: d to i)."
    walkers_experiment(name, "One walker (the paper's Fig. 5 and 6)", "one-walker", caption, options)


if __name__ == "__main__":
    sys.exit(main(experiment))
