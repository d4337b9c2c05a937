"""``python -m wovenfab`` is the ``wovenfab`` command."""

from wovenfab.cli.app import main

if __name__ == "__main__":
    main()
