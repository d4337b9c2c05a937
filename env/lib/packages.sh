# The list of Debian packages, and the key that names a root made from it.

suite=${WOVENFAB_SUITE:-trixie} # Debian 13
list=packages.txt
if [ "$suite" = wheels ]; then # a bare Debian 13, with FEniCSx from PyPI
  suite=trixie list=wheels.txt
fi

# Prints a list without comments and blank lines, one entry a line.
entries() { sed -e 's/#.*//' -e 's/[[:space:]]*$//' -e '/^$/d' "$1"; }

package_list() { entries "${WOVENFAB_PACKAGES:-$project/env/$list}" | sort -u; }

# Raise the number when env/lib/root.sh makes a root differently from the same list.
root_key() {
  local recipe=1
  { echo "$suite $(uname -m) $recipe" && package_list; } | sha256sum | cut -c1-16
}

# Whether the machine itself is the Debian that is asked for; sid has no version of its own.
is_suite() {
  [ "$suite" = trixie ] && (. /etc/os-release && [ "${ID:-}:${VERSION_ID:-}" = debian:13 ]) 2>/dev/null
}

packages_installed() {
  local wanted states
  mapfile -t wanted < <(package_list)
  states=$(dpkg-query -W -f '${db:Status-Status}\n' "${wanted[@]}" 2>/dev/null) || return 1
  ! grep -qvx installed <<<"$states"
}
