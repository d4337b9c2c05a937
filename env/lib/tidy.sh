# Tidying up the roots in the cache: what interruptions left, old ones, all of them.

# Removes what an interruption left of a root; its lock must be held.
discard_partial() {
  local scratch
  scratch=$(cat "$1.partial/scratch" 2>/dev/null) || scratch=
  case $scratch in /*/wovenfab.??????) remove_tree "$scratch" || true ;; esac
  remove_tree "$1.partial"
}

# Removes a finished root unless a command runs in it; its lock must be held. Renamed
# first, so that an interrupted removal is not taken for a finished root.
discard() {
  local use
  exec {use}<"$1/ready"
  if ! flock --nonblock "$use"; then
    say "keeping $1: a command runs in it"
    return 1
  fi
  removable "$1" && mv --no-target-directory "$1" "$1.partial" && remove_tree "$1.partial"
}

# The keys in the cache, as paths of their roots.
all_roots() { find "$cache/roots" -maxdepth 1 -name '*.lock' 2>/dev/null | sed 's/\.lock$//'; }

unused() { [ -n "$(find "$1/ready" -mtime +30 2>/dev/null)" ]; }

any() { [ -f "$1/ready" ]; }

# Removes leftovers, and the finished roots that a test (unused, any) holds for; leaves
# alone the root of the second argument and what another start makes or uses at this moment.
tidy() {
  local test=$1 but=${2:-} root lock status=0
  while read -r root; do
    [ "$root" != "$but" ] || continue
    exec {lock}>"$root.lock"
    if flock --nonblock "$lock"; then
      discard_partial "$root" || status=1
      if "$test" "$root"; then discard "$root" || status=1; fi
    else
      say "keeping $root: it is being made" && status=1
    fi
    exec {lock}>&-
  done < <(all_roots)
  return "$status"
}
