# Starting a command in a root (bwrap, proot) or on the machine itself (native).

# The machine's folders appear under their own names beside Debian 13's system: whatever
# path a user writes means the same inside and outside. A bwrap root is otherwise read-only.
is_system() {
  case $1 in
    /bin | /boot | /dev | /etc | /lib* | /lost+found | /proc | /run | /sbin | /sys | /usr | /var) ;;
    *) return 1 ;;
  esac
}

# Sets folders and files: what of the machine is shown in a root, under the same name.
choose_shown() {
  local tree=$1 name
  folders=() files=()
  for name in /*; do
    if [ -d "$name" ] && [ ! -L "$name" ] && ! is_system "$name"; then folders+=("$name"); fi
  done
  for name in /var/tmp "$PWD" "$project" "$cache" "${HOME:-}"; do
    case $name in
      /var/* | /run/*) [ ! -d "$name" ] || folders+=("$name") ;;
      /usr/* | /etc/* | /boot/*)
        fail "$name is in a folder that the environment replaces: use one elsewhere" ;;
    esac
  done
  for name in resolv.conf hosts passwd group ssl/certs/ca-certificates.crt; do
    if [ -f "/etc/$name" ] && [ -f "$tree/etc/$name" ]; then files+=("/etc/$name"); fi
  done
}

# The mounts exist only in the command's own namespace and end with it.
start_bwrap() {
  local tree=$1 name arguments=()
  shift
  for name in "$tree"/*; do
    [ ! -L "$name" ] || arguments+=(--symlink "$(readlink "$name")" "/${name##*/}")
  done
  for name in /*; do
    [ ! -L "$name" ] || is_system "$name" || arguments+=(--symlink "$(readlink "$name")" "$name")
  done
  arguments+=(--ro-bind "$tree/usr" /usr --ro-bind "$tree/etc" /etc)
  arguments+=(--ro-bind-try "$tree/var/lib/dpkg" /var/lib/dpkg) # which packages are there
  arguments+=(--dev /dev --proc /proc --ro-bind /sys /sys)
  for name in "${folders[@]}"; do arguments+=(--bind "$name" "$name"); done
  for name in "${files[@]}"; do arguments+=(--ro-bind "$name" "$name"); done
  # mpirun names its folder after its process number, which another start has as well.
  arguments+=(--tmpfs /run/mpi)
  export PRTE_MCA_prte_tmpdir_base=/run/mpi
  attend bwrap --die-with-parent --unshare-pid "${arguments[@]}" --remount-ro / \
    --chdir "$PWD" /usr/bin/env "$default_signals" "$@"
}

# Where namespaces are refused: proot rewrites paths, so that nothing is mounted at all.
start_proot() {
  local tree=$1 name arguments=(-b /dev -b /proc -b /sys)
  shift
  for name in "${folders[@]}" "${files[@]}"; do arguments+=(-b "$name"); done
  export PMIX_MCA_gds=hash # PMIx's shared memory fails under proot
  attend proot -r "$tree" "${arguments[@]}" -w "$PWD" \
    /usr/bin/env "$default_signals" "$@"
}

start_native() { exec "$@"; }
