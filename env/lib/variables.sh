# The variables of a command: few come from outside, so that a machine's own Python, MPI or
# PETSc cannot get in the way.

is_kept() {
  case $1 in
    HOME | PWD | USER | LOGNAME | TERM | COLORTERM | COLUMNS | LINES | TZ | CI) ;;
    NO_COLOR | FORCE_COLOR | WOVENFAB_* | PETSC_OPTIONS | PYTEST_* | HYPOTHESIS_* | OPENBLAS_*) ;;
    OMPI_MCA_* | PMIX_MCA_* | PRTE_MCA_*) ;;
    PIP_INDEX_URL | PIP_TRUSTED_HOST | PIP_DEFAULT_TIMEOUT) ;;
    http_proxy | https_proxy | no_proxy | HTTP_PROXY | HTTPS_PROXY | NO_PROXY) ;;
    *) return 1 ;;
  esac
}

forget_variables() {
  local name
  for name in $(compgen -e); do is_kept "$name" || unset "$name"; done
}

# Prints the commit of the code, + after it where files differ from it; nothing without git.
commit() {
  local hash changed
  [ -e "$project/.git" ] || return 0
  hash=$(git -C "$project" rev-parse --short=12 HEAD 2>/dev/null) || return 0
  changed=$(git -C "$project" --no-optional-locks status --porcelain -- \
    forms wovenfab configs meshes 2>/dev/null) || return 0
  echo "$hash${changed:++}"
}

set_variables() {
  export PATH=$project/env/bin:/usr/bin:/bin:/usr/sbin:/sbin
  export PYTHONPATH=$project PYTHONNOUSERSITE=1 LANG=C.UTF-8
  # JIT and other caches, warm at the next start; another suite's own are a folder of them.
  export XDG_CACHE_HOME=$cache/cache${WOVENFAB_SUITE:+/$WOVENFAB_SUITE}
  mkdir -p "$XDG_CACHE_HOME"
  export WOVENFAB_COMMIT=${WOVENFAB_COMMIT-$(commit)} # what results and pictures tell
  export OMP_NUM_THREADS=1           # MPI ranks share the cores; threads make MUMPS slower
  # mpirun: as root in a container, more ranks than cores, several runs on the same cores.
  export OMPI_ALLOW_RUN_AS_ROOT=1 OMPI_ALLOW_RUN_AS_ROOT_CONFIRM=1
  if [ "$suite" = trixie ]; then
    export PRTE_MCA_rmaps_default_mapping_policy=:oversubscribe
    export PRTE_MCA_hwloc_default_binding_policy=none
  else # their names since Open MPI 6
    export PRTE_MCA_mapby=:oversubscribe PRTE_MCA_bindto=none
  fi
  # One machine's ranks talk through its memory, whatever its network; a cluster sets its own.
  export OMPI_MCA_btl=${OMPI_MCA_btl:-self,sm}
  export WOVENFAB_ENTER=native # a start within a start runs the command directly
  unset WOVENFAB_MMDEBSTRAP WOVENFAB_MIRROR WOVENFAB_PACKAGES
}
