"""``python -m wovenfab.bench`` prints every figure and fails where one is missed."""

import sys

from wovenfab.bench.cold_start import cold_start

if __name__ == "__main__":
    sys.exit(0 if all(measure() for measure in (cold_start,)) else 1)
