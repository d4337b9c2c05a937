#!/bin/bash
# with-wheels.sh COMMAND...: runs a command with FEniCSx from PyPI. What the extra "wheels" of
# pyproject.toml and env/wheels-tests.txt list is installed at first use, without wovenfab itself.
set -euo pipefail
shopt -s inherit_errexit

project=$(cd "$(dirname "$(readlink -f "$0")")/../.." && pwd -P)
. "$project/env/lib/say.sh"
. "$project/env/lib/packages.sh"

wanted() {
  python3 -c 'import sys, tomllib
with open(sys.argv[1], "rb") as file:
    print(*tomllib.load(file)["project"]["optional-dependencies"]["wheels"], sep="\n")
' "$project/pyproject.toml"
  entries "$project/env/wheels-tests.txt"
}

folder=$XDG_CACHE_HOME/venv-$( { python3 --version && wanted; } | sha256sum | cut -c1-16)
if [ ! -f "$folder/ready" ]; then
  exec {lock}>"$folder.lock"
  flock "$lock"
  if [ ! -f "$folder/ready" ]; then
    say "installing FEniCSx from PyPI into $folder, once: 1.6 GB"
    rm -rf "$folder"
    python3 -m venv "$folder"
    wanted >"$folder/wanted.txt"
    "$folder/bin/pip" install --quiet --disable-pip-version-check --no-cache-dir \
      --requirement "$folder/wanted.txt" >&2 || fail "pip could not install it"
    touch "$folder/ready"
  fi
  exec {lock}>&-
fi
export PATH=$project/env/bin:$folder/bin:/usr/bin:/bin:/usr/sbin:/sbin
exec "$@"
