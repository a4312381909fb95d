"""``python -m fosopt``, the same as the command ``fosopt``."""

from fosopt.cli import main

if __name__ == "__main__":
    main()
