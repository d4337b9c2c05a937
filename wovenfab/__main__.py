"""``python -m wovenfab`` is the ``wovenfab`` command."""

from wovenfab.commands import main

if __name__ == "__main__":
    main()
