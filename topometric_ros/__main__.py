"""`python -m topometric_ros`: the `topometric` command."""

import sys

from topometric_ros.cli.main import main

if __name__ == "__main__":
    sys.exit(main())
