"""`python -m neural_renderer`: the console command."""

import sys

from .cli import main

sys.exit(main())
