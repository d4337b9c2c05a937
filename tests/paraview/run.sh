#!/bin/sh
# Proves that ParaView opens fields and yarns of a run in all three of its XDMF readers.
# usage: tests/paraview/run.sh [DIR]
# DIR is a results directory after wovenfab report; without it a made-up run is taken.
set -eu

project=$(cd "$(dirname "$0")/../.." && pwd -P)
if [ $# -gt 0 ]; then
  directory=$1
else
  folder=$(mktemp -d)
  trap 'rm -r "$folder"' EXIT
  directory=$folder/results
  "$project/env/enter" python3 "$project/tests/report/sample.py" "$directory"
  "$project/env/enter" wovenfab report "$directory"
fi
WOVENFAB_PACKAGES=$project/tests/paraview/packages.txt \
  "$project/env/enter" pvpython "$project/tests/paraview/check.py" "$directory"
