# Runs bwrap or proot and stays until it ends, because neither passes signals on.

handled=(INT QUIT TERM HUP)
default_signals=--default-signal=$(IFS=, && echo "${handled[*]}") # for the command, by env

# attend STARTER ARGUMENTS...: ends with the command's exit code. A terminal's Ctrl-C reaches
# the command by itself, TERM and HUP are passed on; the starter ignores them all.
attend() {
  local starter code told=
  trap 'told=yes' INT QUIT
  trap 'told=yes; pass_on TERM "$starter"' TERM
  trap 'told=yes; pass_on HUP "$starter"' HUP
  (trap '' "${handled[@]}" && exec "$@") <&0 &
  starter=$!
  while true; do
    code=0
    wait "$starter" || code=$?
    [ -n "$told" ] || exit "$code"
    told=
  done
}

# Sends a signal to the command that a starter runs: its first descendant of another name.
pass_on() {
  local pid=$2 child
  while [[ $(cat "/proc/$pid/comm") == @(bwrap|proot) ]]; do
    read -r child _ < <(cat "/proc/$pid/task/$pid/children" && echo)
    [ -n "$child" ] || break
    pid=$child
  done 2>/dev/null
  kill -s "$1" "$pid" 2>/dev/null || true
}
