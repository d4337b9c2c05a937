# Where Debian's packages come from: the mirror that this machine already uses.

# Prints the address that apt has for Debian's own main archive, or nothing; apt itself
# reads both forms of its sources and knows whose archive each one is.
own_mirror() {
  local uri codename
  codename=$(. /etc/os-release && echo "${VERSION_CODENAME:-}") || return 0
  while read -r uri; do
    case $uri in http://* | https://*) echo "$uri" && return ;; esac
  done < <(apt-get indextargets --format '$(REPO_URI)' 'Created-By: Packages' \
    'Origin: Debian' 'Component: main' "Codename: $codename" 2>/dev/null)
}

# Prints the mirror for a root; nothing stands for mmdebstrap's default.
mirror() { if [ -n "${WOVENFAB_MIRROR:-}" ]; then echo "$WOVENFAB_MIRROR"; else own_mirror; fi; }

# Prints the proxy that apt is told to use, or nothing.
apt_proxy() {
  local proxy=
  eval "$(apt-config shell proxy Acquire::http::Proxy 2>/dev/null)"
  [ "$proxy" = DIRECT ] || echo "$proxy"
}
