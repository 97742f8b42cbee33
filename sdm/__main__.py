"""`python -m sdm`, the same as the command `sdm`."""

import sys

from sdm.cli import main

sys.exit(main())
