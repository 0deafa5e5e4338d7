"""``python -m slammot_graph``: the same as the command ``slammot-graph``."""

import sys

from slammot_graph.cli import main

if __name__ == "__main__":
    sys.exit(main())
