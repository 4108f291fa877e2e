# shellcheck shell=bash
# Where Debian comes from.

# debian_mirror: prints where this machine gets Debian from.
debian_mirror() {
  # shellcheck disable=SC2016  # apt's fields, not variables
  { apt-get indextargets --format '$(ORIGIN) $(LABEL) $(REPO_URI)' 'Created-By: Packages' || true; } |
    awk '$1 " " $2 == "Debian Debian" { print $3; found = 1; exit }
         END { if (!found) print "http://deb.debian.org/debian" }'
}
