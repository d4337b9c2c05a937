"""``python -m wovenfab`` is the ``wovenfab`` command."""

from wovenfab.cli import main

if __name__ == "__main__":
    main()
