"""`python -m stltool`."""

from stltool.cli import main

main()
