# Removal of a folder tree. Anything of the machine mounted below would be deleted with it,
# a bind mount from the same file system too: hence the look at the mounts first.

# Prints the mount points at or below a folder (/proc/self/mounts writes a space as \040).
mounts_below() {
  local point
  while read -r _ point _; do
    point=$(printf '%b' "$point")
    if [[ $point == "$1" || $point == "$1"/* ]]; then printf '%s\n' "$point"; fi
  done </proc/self/mounts
}

# Whether a folder may be removed; says why not.
removable() {
  local folder mounted
  if [ -L "$1" ]; then
    say "not removing $1: it is a link, not a folder made here"
    return 1
  fi
  folder=$(cd "$(dirname "$1")" && pwd -P)/$(basename "$1")
  mounted=$(mounts_below "$folder")
  if [ -n "$mounted" ]; then
    say "not removing $folder: something is mounted in it; unmount this first:"
    printf '  %s\n' "$mounted" >&2
    return 1
  fi
}

# Removes a folder on its own file system, or refuses with status 1.
remove_tree() {
  [ -e "$1" ] || [ -L "$1" ] || return 0
  removable "$1" || return 1
  rm -rf --one-file-system -- "$1" 2>/dev/null && return
  # An ordinary user's mmdebstrap leaves files of the user's subordinate ids behind.
  if [ "$(id -u)" -ne 0 ] && command -v mmdebstrap >/dev/null; then
    mmdebstrap --unshare-helper rm -rf --one-file-system -- "$1" 2>/dev/null || true
    rm -rf --one-file-system -- "$1" 2>/dev/null && return
  fi
  say "could not remove all of $1"
  return 1
}
