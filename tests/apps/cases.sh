#!/usr/bin/env bash
# cases.sh COMMAND [PYTHON]: every folder of ../shared/cases with a run.sh, once; a line a case with "ok", "failed" or "skipped"
# and, of one that failed, what it printed. ICLK_CASES is another folder. Ends with 77 where there are no cases.
set -uo pipefail
export ICLK=$1 PYTHON=${2:-python3}
here=$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)
cases=${ICLK_CASES:-$here/../../../shared/cases}
ran=0 failed=0
for run in "$cases"/*/run.sh; do
  [ -x "$run" ] || continue
  name=$(basename "$(dirname "$run")") code=0
  said=$("$run" 2>&1) || code=$?
  case $code in
    0) echo "ok       $name" ;;
    77) echo "skipped  $name: $said" ;;
    *) echo "failed   $name"; sed 's/^/         /' <<<"$said"; failed=$((failed + 1)) ;;
  esac
  ran=$((ran + 1))
done
[ $ran -gt 0 ] || { echo "skipped: no cases in $cases (ICLK_CASES names another folder)"; exit 77; }
echo "$ran cases, $failed failed"
[ $failed -eq 0 ]
