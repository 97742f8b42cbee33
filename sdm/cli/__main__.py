"""`python -m sdm.cli`, the same as the command `sdm`."""

import sys

from sdm.cli.app import main

sys.exit(main())
