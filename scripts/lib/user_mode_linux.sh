# shellcheck shell=bash
# Runs a command in User-mode Linux: a Linux kernel that is a process of this machine.

UML_MEMORY_MB=2048
# Versions before 6.13 abort on CPUs with AMX, whose registers take 11 kB; and 6.1, which Debian 12
# has, takes five times as long as 7.2. So the one of Debian's next release is fetched.
UML_RELEASE=forky
UML_FOLDER=${XDG_CACHE_HOME:-${HOME-}/.cache}/user-mode-linux/$UML_RELEASE
UML_LIBRARIES=$UML_FOLDER/usr/lib/x86_64-linux-gnu
UML_LOADER=/lib64/ld-linux-x86-64.so.2
short=

# fetch_user_mode_linux: puts that version and the C library that it needs into UML_FOLDER, once.
# Nothing is installed. Fails where it cannot be had.
fetch_user_mode_linux() {
  [[ ! -e $UML_FOLDER ]] || return 0
  [[ $(uname -m) == x86_64 ]] && command -v dpkg-deb >/dev/null || return
  mkdir -p "${UML_FOLDER%/*}" || return
  local folder package code=0
  echo "with-vcan: fetching User-mode Linux from Debian $UML_RELEASE, once" >&2
  folder=$(mktemp -d "$UML_FOLDER-XXXXXX")
  (
    mkdir -p "$folder"/{lists,cache/archives}/partial "$folder/system" && cd "$folder" || exit
    echo "deb [arch=amd64 signed-by=/usr/share/keyrings/debian-archive-keyring.gpg]" \
      "$(debian_mirror) $UML_RELEASE main" >sources.list
    printf '%s "%s";\n' Dir::Etc::SourceList "$folder/sources.list" Dir::Etc::SourceParts - \
      Dir::State::Lists "$folder/lists" Dir::Cache "$folder/cache" APT::Sandbox::User "" \
      Acquire::Languages none Acquire::Retries 2 Acquire::http::Timeout 20 >settings
    export APT_CONFIG=$folder/settings
    apt-get --quiet=2 update &&
      apt-get --quiet=2 download {user-mode-linux,libc6}/"$UML_RELEASE" || exit
    for package in *.deb; do
      dpkg-deb --extract "$package" system || exit
    done
    mv --no-target-directory system "$UML_FOLDER" || [[ -e $UML_FOLDER ]] # another was first
  ) >&2 || code=$?
  rm -rf "$folder"
  return "$code"
}

# choose_user_mode_linux: sets uml_program, uml_modules (the folder of its modules) and short (a
# folder to remove). Fails where there is none.
choose_user_mode_linux() {
  if fetch_user_mode_linux; then
    uml_modules=$UML_FOLDER/usr/lib/uml/modules
    # It runs with the C library that came with it. It looks for its memory behind the program of
    # the process, so that must not be the loader: the copy names a loader of ours, padded with
    # slashes to the same length.
    short=$(mktemp -d /tmp/uml-XXXXXX)
    local loader=$short/ld.so
    ln -s "$UML_LIBRARIES/${UML_LOADER##*/}" "$loader"
    while ((${#loader} < ${#UML_LOADER})); do
      loader=/$loader
    done
    uml_program=$short/linux.uml
    LC_ALL=C sed "s#$UML_LOADER#$loader#" "$UML_FOLDER/usr/bin/linux.uml" >"$uml_program"
    chmod +x "$uml_program"
  else
    uml_modules=/usr/lib/uml/modules
    uml_program=$(command -v linux.uml)
  fi
}

# run_in_user_mode_linux WRITABLE INIT COMMAND [ARGUMENT...]
# INIT becomes the guest's first process. Beside it, in a folder that the guest can write to, it
# finds what to do (settings, command), and there it leaves the command's exit status.
run_in_user_mode_linux() {
  local writable=$1 init=$2
  shift 2
  exchange=$(mktemp -d "${TMPDIR:-/tmp}/with-vcan-XXXXXX")
  trap 'rm -rf "$exchange" $short' EXIT
  choose_user_mode_linux || fail \
    "this kernel has no vcan (or root's rights to set it up were refused), and there is no" \
    "User-mode Linux. On Debian and Ubuntu: apt-get install user-mode-linux"
  cp "$init" "$exchange/init"
  printf '%s=%q\n' modules "$uml_modules" writable "$writable" \
    cache "${XDG_CACHE_HOME:-${HOME-}/.cache}" >"$exchange/settings"
  {
    export -p
    printf 'cd %q\n' "$PWD"
    printf '%q ' exec "$@"
  } >"$exchange/command"
  boot
  if [[ ! -s $exchange/status ]]; then
    cat "$exchange/console" >&2
    if grep -qw amx_tile /proc/cpuinfo; then
      fail "User-mode Linux ended: version $("$uml_program" --version). Versions before 6.13 cannot" \
        "run programs on this CPU, which has AMX. Use a newer one, or a kernel that has vcan"
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
  TMPDIR=$(memory_folder) setpriv --pdeathsig TERM setsid env LD_LIBRARY_PATH="$UML_LIBRARIES" \
    "$uml_program" seccomp=auto mem="${UML_MEMORY_MB}M" \
    root=/dev/root rootfstype=hostfs rootflags=/ ro quiet \
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
