"""``python -m usbldr``: the command line."""

from usbldr_cli.main import main

main()
