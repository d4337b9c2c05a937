# A root: the files of a Debian with the packages, in a folder of the user's cache.
#   <cache>/roots/<key>/tree     the files
#   <cache>/roots/<key>/ready    written last; its time is that of the last use
#   <cache>/roots/<key>.partial  one being made; what an interruption leaves is removed
#   <cache>/roots/<key>.lock     held by the one who makes or removes it

# Prints the user's home folder: that of the system's list where HOME is not set.
home_folder() {
  local home=${HOME:-$(unset HOME && echo ~)}
  [ -d "$home" ] || fail "there is no home folder '$home': set HOME or XDG_CACHE_HOME"
  echo "$home"
}

cache_folder() {
  local base=${XDG_CACHE_HOME:-}
  [ -n "$base" ] || base=$(home_folder)/.cache
  mkdir -p "$base/wovenfab" 2>/dev/null ||
    fail "cannot write to $base: set XDG_CACHE_HOME to a folder with 4 GB to spare"
  (cd "$base/wovenfab" && pwd -P)
}

# Prints the folder of the root for today's package list, and makes it first if need be.
ensure_root() {
  local root lock
  root=$cache/roots/$(root_key)
  if [ ! -f "$root/ready" ]; then
    mkdir -p "$cache/roots"
    exec {lock}>"$root.lock"
    if ! flock --nonblock "$lock"; then
      say "waiting for another start that is making the environment"
      flock "$lock"
    fi
    if [ ! -f "$root/ready" ]; then
      need "${WOVENFAB_MMDEBSTRAP:-mmdebstrap}" mmdebstrap
      discard_partial "$root" || fail "the environment cannot be made here"
      tidy unused "$root" || true
      make_root "$root"
    fi
    exec {lock}>&-
  fi
  echo "$root"
}

# Makes a root beside its final place and renames it once it is complete on disk.
make_root() {
  local partial=$1.partial start=$SECONDS
  remove_tree "$partial" && remove_tree "$1" || fail "the environment cannot be made here"
  mkdir -p "$partial/tree"
  local what="with FEniCSx, about 3 GB and 4 minutes"
  [ "$list" = packages.txt ] || what="for FEniCSx from PyPI, about 1 GB and a minute"
  say "making the environment, once: Debian $suite $what"
  say "in $1"
  scratch_folder >"$partial/scratch"
  if ! build "$partial/tree" "$(cat "$partial/scratch")"; then
    say "the environment could not be made; the reason stands above"
    discard_partial "$1" || true
    [ "$(id -u)" -eq 0 ] || how_to_go_on
    exit 125
  fi
  remove_tree "$(cat "$partial/scratch")" || true
  package_list >"$partial/ready"
  sync --file-system "$partial"
  mv --no-target-directory "$partial" "$1"
  say "the environment is ready, after $((SECONDS - start)) s"
}

# mmdebstrap works in a folder that its user namespace must reach: a home folder may be
# closed to it, /tmp may be too small. It hands over a tar file, so that every file of the
# root belongs to the user; device nodes stay out (a start lays its own /dev).
build() {
  local tree=$1 scratch=$2 mode=unshare proxy options=() source
  mapfile -t source < <(mirror)
  if [ "$suite" = sid ]; then # mirrors may be behind what its signature allows
    options=(--aptopt='Acquire::Check-Valid-Until "false"')
    source=("deb [trusted=yes] ${source:-http://deb.debian.org/debian} sid main")
  fi
  [ "$(id -u)" -ne 0 ] || mode=root
  proxy=$(apt_proxy)
  TMPDIR=$scratch http_proxy=${http_proxy:-$proxy} "${WOVENFAB_MMDEBSTRAP:-mmdebstrap}" \
    --mode=$mode --variant=apt --format=tar \
    --dpkgopt=force-unsafe-io --aptopt='APT::Install-Recommends "false"' \
    --include="$(package_list | paste -sd,)" "${options[@]}" "$suite" - "${source[@]}" </dev/null |
    tar --extract --no-same-owner --no-same-permissions --exclude='./dev/*' \
      --directory="$tree" &&
    chmod -R u+rwX "$tree" &&
    touch "$tree/etc/resolv.conf" "$tree/etc/hosts" # for the machine's own to be laid over
}

scratch_folder() {
  local folder
  folder=$(mktemp -d "${TMPDIR:-/var/tmp}/wovenfab.XXXXXX")
  chmod 755 "$folder"
  echo "$folder"
}
