#!/usr/bin/env bash
# Does packaging/Containerfile install what the command is linked with? containerfile.sh COMMAND
# Follows what the installed packages depend on, from those that the last stage names. On Debian 12 alone, whose names they are.
set -euo pipefail
containerfile=$(dirname "${BASH_SOURCE[0]}")/../../packaging/Containerfile
[ "$(. /etc/os-release; echo "${ID:-} ${VERSION_ID:-}")" = "debian 12" ] || { echo "SKIPPED: no Debian 12"; exit 77; }

# The packages of the last stage, and all that they need.
mapfile -t todo < <(awk '/^FROM/ {text = ""} {text = text " " $0} END {print text}' "$containerfile" |
  sed 's/.*--no-install-recommends//; s/&&.*//; s/\\//g' | tr -s ' ' '\n' | sed '/^$/d')
[ ${#todo[@]} -gt 5 ] || { echo "no packages found in $containerfile"; exit 1; }
declare -A there
while [ ${#todo[@]} -gt 0 ]; do
  for package in "${todo[@]}"; do there[$package]=1; done
  mapfile -t todo < <(dpkg-query --show --showformat '${Depends}, ${Pre-Depends}\n' "${todo[@]}" 2>/dev/null |
    tr ',|' '\n\n' | sed 's/(.*//; s/:any//; s/[[:space:]]//g; /^$/d' | sort -u |
    while read -r package; do [ -n "${there[$package]:-}" ] || echo "$package"; done)
done

missing=0
while read -r library; do
  file=$(ldd "$1" | awk -v name="$library" '$1 == name {print $3}')
  [ -n "$file" ] || continue  # the dynamic linker itself
  file=$(readlink -f "$file")
  # Where /lib is a link to /usr/lib dpkg may know either.
  package=$({ dpkg -S "$file" || dpkg -S "${file#/usr}"; } 2>/dev/null | cut -d: -f1)
  [ -z "${there[$package]:-}" ] || continue
  echo "$library is of $package, which $containerfile does not install"
  missing=1
done < <(objdump -p "$1" | awk '$1 == "NEEDED" {print $2}')
exit $missing
