"""``python -m calib``."""

import sys

from calib.cli.main import main

sys.exit(main())
