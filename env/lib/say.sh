# Messages go to standard error: standard output belongs to the command.

say() { printf 'wovenfab: %s\n' "$*" >&2; }

# Ends with 125, as env, timeout and docker do when they themselves fail, not the command.
fail() {
  say "$@"
  exit 125
}
