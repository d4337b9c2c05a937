# Runs bwrap or proot and stays until it ends, because neither passes signals on.

handled=(INT QUIT TERM HUP USR1)
default_signals=--default-signal=$(IFS=, && echo "${handled[*]}") # for the command, by env

# attend STARTER ARGUMENTS...: ends with the command's exit code. A terminal's Ctrl-C reaches
# the command by itself; TERM, HUP, USR1 and an INT from elsewhere are passed on. The starter
# ignores them all.
attend() {
  local starter code told=
  trap 'told=yes' QUIT
  trap 'told=yes; is_in_front || pass_on INT "$starter"' INT
  trap 'told=yes; pass_on USR1 "$starter"' USR1
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

# Whether this is in front of a terminal, so that Ctrl-C reaches the command, too.
is_in_front() {
  local fields
  read -ra fields < <(sed 's/.*) //' "/proc/$$/stat")
  [ "${fields[2]}" = "${fields[5]}" ]
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
