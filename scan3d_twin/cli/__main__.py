"""``python -m scan3d_twin.cli``."""

import sys

from scan3d_twin.cli.app import main

sys.exit(main())
