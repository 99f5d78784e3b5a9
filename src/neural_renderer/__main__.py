"""`python -m neural_renderer`: the console command."""

import sys

from .apps.command_line import main

sys.exit(main())
