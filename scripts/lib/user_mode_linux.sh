# shellcheck shell=bash
# Runs a command in User-mode Linux: a Linux kernel that is a process of this machine.

UML_MEMORY_MB=2048

# run_in_user_mode_linux WRITABLE INIT COMMAND [ARGUMENT...]
# INIT becomes the guest's first process. Beside it, in a folder that the guest can write to, it
# finds what to do (settings, command), and there it leaves the command's exit status.
run_in_user_mode_linux() {
  local writable=$1 init=$2
  shift 2
  exchange=$(mktemp -d "${TMPDIR:-/tmp}/with-vcan-XXXXXX")
  trap 'rm -rf "$exchange"' EXIT
  cp "$init" "$exchange/init"
  printf '%s=%q\n' writable "$writable" cache "${XDG_CACHE_HOME:-${HOME-}/.cache}" \
    >"$exchange/settings"
  {
    export -p
    printf 'cd %q\n' "$PWD"
    printf '%q ' exec "$@"
  } >"$exchange/command"
  boot
  if [[ ! -s $exchange/status ]]; then
    cat "$exchange/console" >&2
    if grep -qw amx_tile /proc/cpuinfo; then
      fail "User-mode Linux ended: version $(linux.uml --version) cannot run programs on this CPU," \
        "which has AMX. Use a machine without AMX, or one whose kernel has vcan"
    fi
    fail "User-mode Linux ended before the command did; above is what it said"
  fi
  return "$(<"$exchange/status")"
}

# boot: boots the guest and waits for its end. The command's output comes through two serial lines,
# so that what the kernel says does not mix with it. The guest is no member of the terminal's
# process group: Ctrl-C would kill the kernel and not reach the command.
boot() {
  local uml cats signal output errors
  exec {output}> >(exec cat) && cats=$!
  exec {errors}> >(exec cat >&2) && cats+=" $!"
  TMPDIR=$(memory_folder) setpriv --pdeathsig TERM setsid linux.uml \
    mem="${UML_MEMORY_MB}M" root=/dev/root rootfstype=hostfs rootflags=/ ro quiet \
    init="$exchange/init" con=null ssl=null ssl0=null,fd:"$output" ssl1=null,fd:"$errors" \
    </dev/null >"$exchange/console" 2>&1 &
  uml=$!
  exec {output}>&- {errors}>&-
  for signal in INT TERM HUP; do
    trap "pass_on $signal $uml" "$signal"
  done
  while kill -0 "$uml" 2>/dev/null; do
    wait "$uml" || true
  done
  trap - INT TERM HUP
  tail --pid="${cats% *}" -f /dev/null && tail --pid="${cats#* }" -f /dev/null
}

# pass_on SIGNAL UML: the first signal goes to the command, one after two seconds or more ends the
# guest. (A terminal and timeout(1) may each send the same one twice at a time.)
pass_on() {
  if [[ ! -e $exchange/signal ]]; then
    asked_at=$SECONDS
    echo "$1" >"$exchange/signal"
  elif ((SECONDS >= asked_at + 2)); then
    kill "$2" 2>/dev/null || true
  fi
}

# memory_folder: prints where the guest's memory may lie; a container's /dev/shm is often tiny.
memory_folder() {
  local free_kb
  free_kb=$(df --output=avail /dev/shm 2>/dev/null | tail -n 1)
  if ((${free_kb:-0} > UML_MEMORY_MB * 1024)); then
    echo /dev/shm
  else
    echo "${TMPDIR:-/tmp}"
  fi
}
