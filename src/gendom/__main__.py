"""`python -m gendom`."""

import sys

from gendom.cli import main

sys.exit(main())
