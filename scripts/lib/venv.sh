# shellcheck shell=bash
# Sets up .venv in the repository. Sourced by scripts whose working folder is its root.

# 3.11 comes first because pybullet has a wheel for it alone; with the others the plant runs on MuJoCo.
PYTHON_CANDIDATES=(python3.11 python3 python3.12 python3.13 python3.14)

# find_python: prints the path of a Python 3.11 or newer; PYTHON in the environment goes first.
find_python() {
  local candidate
  for candidate in ${PYTHON:+"$PYTHON"} "${PYTHON_CANDIDATES[@]}"; do
    if "$candidate" -c 'import sys, ensurepip, venv; sys.exit(sys.version_info < (3, 11))' \
      2>/dev/null; then
      command -v "$candidate"
      return
    fi
  done
  {
    echo "No Python 3.11 or newer with its venv module (tried ${PYTHON:-} ${PYTHON_CANDIDATES[*]})."
    echo "On Debian and Ubuntu: apt-get install python3 python3-venv. Or set PYTHON to the path of one."
  } >&2
  return 1
}

# venv_state: prints what an installation depends on; fails where .venv cannot be used.
venv_state() {
  .venv/bin/python - 2>/dev/null <<'PYTHON'
import hashlib, pathlib, sys
print(sys.version, hashlib.sha256(pathlib.Path("pyproject.toml").read_bytes()).hexdigest())
PYTHON
}

# remove_leftovers: removes what installing, uninstalling and moving files leaves behind: folders
# of this project that hold nothing but Python's caches. One in site-packages hides the sources.
remove_leftovers() {
  local installed caches parent
  for installed in .venv/lib/python*/site-packages/{bus_schema,controller,deploy,funnel_hil,plant_emulator}; do
    if [[ -d $installed && -z $(find "$installed" -name '*.py' -print -quit) ]]; then
      echo "Removing $installed: it holds no sources, and hides those here"
      rm -r "$installed"
    fi
  done
  local -a found
  mapfile -t found < <(find bus_schema controller deploy plant_emulator tests -depth -name __pycache__)
  for caches in "${found[@]}"; do
    parent=${caches%/*}
    if [[ $(ls -A "$parent") == __pycache__ ]]; then
      rm -r "$caches"
      rmdir --parents --ignore-fail-on-non-empty "$parent"
    fi
  done
}

# while_it_lasts COMMAND...: runs it, and says every half minute (TOLD_EVERY_S) that it goes on.
while_it_lasts() {
  local begun=$SECONDS told
  (
    trap 'kill "$!"; exit' TERM # no sleep is left behind that keeps a pipe open
    while sleep "${TOLD_EVERY_S:-30}" & wait "$!"; do
      echo "… still at it, $((SECONDS - begun)) s"
    done
  ) &
  told=$!
  local code=0
  "$@" || code=$?
  kill "$told" 2>/dev/null
  wait "$told" 2>/dev/null || true
  return "$code"
}

# install_quietly LOG EXTRAS: installs this project; what pip prints goes to LOG.
install_quietly() {
  .venv/bin/python -m pip install --quiet --disable-pip-version-check --no-input \
    --editable ".${2:+[$2]}" >"$1" 2>&1
}

# ensure_venv EXTRAS: provides .venv with this project and EXTRAS ("" or "dev") installed in it.
# Stamps in .venv tell what it holds; as long as they are up to date, nothing is done.
ensure_venv() {
  local extras=$1 state base
  # The files of a virtual environment name its folder, so a moved or copied one is of no use.
  if ! state=$(venv_state) || [[ $(cat .venv/root 2>/dev/null) != "$PWD" ]]; then
    base=$(find_python)
    echo "Creating .venv with $("$base" --version) ($base)"
    "$base" -m venv --clear .venv
    echo "$PWD" >.venv/root
    state=$(venv_state)
  fi
  remove_leftovers
  local stamp=".venv/installed${extras:+-$extras}"
  if [[ $(cat "$stamp" 2>/dev/null) == "$state" ]]; then
    return
  fi
  echo "Installing funnel-hil${extras:+[$extras]} into .venv (a minute or two at first)"
  local log
  log=$(mktemp) # what pip warns of matters only where it fails
  if ! while_it_lasts install_quietly "$log" "$extras"; then
    cat "$log" >&2
    rm "$log"
    return 1
  fi
  rm "$log"
  echo "$state" >"$stamp"
  remove_leftovers # of the installation that this one replaced
  # What pip does for all it installs, but not for an editable project; without it, every start of a
  # user who keeps Python from writing caches (PYTHONDONTWRITEBYTECODE) compiles all sources again.
  .venv/bin/python -m compileall -q bus_schema controller deploy plant_emulator
  echo "$state" >.venv/installed # whatever the extras, the project itself is there
}
