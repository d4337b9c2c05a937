# The tools that make and start a root, and what to say where they are missing.

have() { command -v "$1" >/dev/null; }

# Two starts at once install one after the other; apt waits for any other program's lock.
apt_install() {
  local lock
  say "installing with apt-get: $*"
  exec {lock}>"$cache/apt.lock"
  flock "$lock"
  apt-get update >&2 &&
    DEBIAN_FRONTEND=noninteractive apt-get -o DPkg::Lock::Timeout=300 \
      install --yes --no-install-recommends "$@" >&2
}

can_install() { [ "$(id -u)" -eq 0 ] && have apt-get; }

how_to_go_on() {
  if is_suite; then
    cat >&2 <<EOF
Once, as root, from the project's folder:
    sed 's/#.*//' env/packages.txt | xargs apt-get install --no-install-recommends
or, to leave the machine's own packages alone:
EOF
  else
    echo "Once, as root (Debian 12 or newer):" >&2
  fi
  cat >&2 <<EOF
    apt-get install mmdebstrap uidmap bubblewrap proot
    (your user needs a line in /etc/subuid and /etc/subgid too: adduser writes them)
or use the container image, from the project's folder:
    docker build --tag wovenfab .
    docker run --rm --user "\$(id -u):\$(id -g)" --volume "\$PWD:/work" wovenfab run configs/bias-1x3.yaml
EOF
}

# Makes sure of one command: need COMMAND PACKAGE...
need() {
  local command=$1
  shift
  have "$command" && return
  if can_install; then
    apt_install "$@" || fail "apt-get could not install $*"
  else
    say "$command is missing, and only root can install it."
    how_to_go_on
    exit 125
  fi
}

# Private namespaces with a fresh /proc, as env/lib/start.sh will ask for them.
bwrap_works() {
  have bwrap && bwrap --ro-bind / / --dev /dev --unshare-pid --proc /proc true 2>/dev/null
}
