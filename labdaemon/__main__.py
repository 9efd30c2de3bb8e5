"""`python -m labdaemon` is the `labdaemon` command."""

from labdaemon.cli.main import main

if __name__ == "__main__":
    main()
