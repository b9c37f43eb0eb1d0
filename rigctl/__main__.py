"""``python -m rigctl``: the same as ``rigctl``."""

from rigctl.cli.entry import main

if __name__ == "__main__":
    main()
