"""`python -m labdaemon` is the `labdaemon` command."""

from labdaemon.cli.main import main

main()
