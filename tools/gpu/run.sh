#!/usr/bin/env bash
# Measures the denoiser on this machine's GPU, most important first, within a number of seconds. Every step fails alone.
#   run.sh SECONDS OUT     everything as files in OUT; a short table on standard output
# STEPS="check networks" picks from: device check networks sweep first parts.
set -uo pipefail
[ $# = 2 ] || { sed -n '2,4s/^# \{0,1\}//p' "$0" >&2; exit 2; }
end=$(($(date +%s) + $1))
mkdir -p "$2"
out=$(cd "$2" && pwd)
cd "$(dirname "$0")"
steps=${STEPS:-device check networks sweep first parts}
export VKDENOISE_GOLDEN=$PWD/data XDG_CACHE_HOME=$out/cache VKDENOISE_VALIDATION=${VKDENOISE_VALIDATION:-off}

left() { echo $((end - $(date +%s))); }
# step NAME MOST COMMAND...: its output in OUT/NAME, its end in the table.
step() {
  local name=$1 most=$2 began status
  shift 2
  if [ "$(left)" -lt 5 ]; then echo "$name: no time left"; return 1; fi
  [ "$most" -le "$(left)" ] || most=$(left)
  began=$(date +%s.%N)
  timeout "$most" "$@" > "$out/$name" 2> "$out/$name.log"
  status=$?
  [ -s "$out/$name.log" ] || rm -f "$out/$name.log"
  local seconds
  seconds=$(awk -v a="$began" -v b="$(date +%s.%N)" 'BEGIN { printf "%.1f", b - a }')
  case $status in
    0) echo "$name: ok ($seconds s)" ;;
    *) echo "$name: FAILED with $status ($seconds s): $(grep -hE 'panicked|error|Error|FAILED' "$out/$name" "$out/$name.log" 2>/dev/null | head -1)" ;;
  esac >> "$out/steps"
  tail -1 "$out/steps"
  return $status
}
# The median that follows a key of an indented JSON file.
median() { awk -v key="\"$2\":" '$1 == key { found = 1 } found && $1 == "\"median\":" { gsub(",", "", $2); print $2; exit }' "$1"; }
# Microseconds, megabytes read and written and the name of every kernel of such a file, the longest first.
by_kernel() {
  awk '$1 == "\"by_kernel\":" { inside = 1 } $1 == "\"by_stage\":" { inside = 0 } { gsub("[\",]", "", $2) }
    inside && $1 == "\"kernel\":" { kernel = $2 } inside && $1 == "\"mb_read\":" { bytes = $2 }
    inside && $1 == "\"mb_written\":" { bytes += $2 } inside && $1 == "\"median\":" { time = $2 }
    inside && $1 == "\"variant\":" { printf "%10.1f us %10.1f MB  %s\n", time, bytes, kernel }' "$1" | sort -nr
}

: > "$out/steps"
cp commit "$out/" 2>/dev/null
wants() { [[ " $steps " == *" $1 "* ]]; }

if wants device; then
  step device.txt 30 bin/vkdenoise --list-devices
  step roof.json 40 bin/vkdenoise-profile roof --json
fi
if wants check; then
  for name in kernels attention convolutions matrix predicted stats signals neutral; do
    step "check-$name.txt" 90 "tests/$name" --nocapture --test-threads=4
  done
fi
# A whole pass with planes in device memory, plain and with every kernel timed. `kernels` is the Hybrid that predicts
# kernels, the network that ships; `hybrid` is the thesis's, with a residual, of which docs/performance.md has the times.
# Weights are random: the work does not depend on them.
network() {
  local name=$1 size=$2 tier=$3 repeat=$4 arch=(--arch "$1")
  shift 4
  [ "$name" != kernels ] || arch=(--arch hybrid --head gloss)
  step "network-$name-$size-$tier.json" 60 bin/vkdenoise-profile network "${arch[@]}" --size "$size" --precision "$tier" \
    --repeat "$repeat" --warm-up 5 --json "$@"
}
if wants networks; then
  for name in kernels hybrid; do
    for size in 1024x1024 256x256 512x512 1920x1080 2048x2048 3840x2160; do network $name $size matrix 15; done
  done
  network expanded_patch 1024x1024 matrix 15
  for name in kernels hybrid; do
    for size in 1024x1024 512x512 256x256; do network $name $size fp32 9; network $name $size fp16 9; done
  done
  network expanded_patch 1024x1024 fp32 9
fi
# sweep SIZE CHOICE...: the network that ships, each choice in turn.
sweep() {
  local size=$1 choice name
  shift
  for choice in "$@"; do
    name=${choice#--}
    # shellcheck disable=SC2086
    step "sweep-kernels-$size-${name// /=}.json" 60 bin/vkdenoise-profile network --head gloss --size "$size" --precision matrix \
      --repeat 15 --warm-up 5 --json $choice
  done
}
if wants sweep; then
  # A block's attention as one kernel or as four; FFNs as two kernels in place of one; subgroups that share a tile's
  # tokens: as many everywhere; MiB of a map between consecutive operations, above which they run band by band.
  for size in 1024x1024 256x256; do
    sweep $size "--attention joined" "--attention four-kernels" "--ffn two-kernels" \
      "--matrix-halves 1" "--matrix-halves 2"
  done
  sweep 1024x1024 "--max-chain-mib 32" "--max-chain-mib 64"
fi

if wants first; then
  # A process with nothing cached, then one with the pipelines of the first.
  for turn in cold warm; do
    step "first-$turn.json" 60 bin/vkdenoise data/teapot_spp0004.exr -o "$out/denoised.exr" --json
  done
fi
if wants parts; then
  step conv.json 60 bin/vkdenoise-profile conv --json
  step blocks.json 90 bin/vkdenoise-profile blocks --sizes 128,256,512,1024,2048 --json
  step tables.json 120 bin/vkdenoise-profile tables --size 1024 --json
fi
# Where the time goes, kernel by kernel.
for file in "$out"/network-*.json "$out"/sweep-*.json; do
  [ ! -s "$file" ] || by_kernel "$file" > "${file%.json}.txt"
done

printf '\n%-18s %-12s %-24s %10s %10s\n' network size 'tier or choice' 'pass ms' 'kernels ms'
for file in "$out"/network-*.json "$out"/sweep-*.json; do
  [ -s "$file" ] || continue
  IFS=- read -r _ arch size tier <<< "$(basename "$file" .json)"
  kernels=$(awk '$1 == "\"kernels_ms\":" { gsub(",", "", $2); print $2; exit }' "$file")
  printf '%-18s %-12s %-24s %10.3f %10.3f\n' "$arch" "$size" "$tier" "$(median "$file" pass_ms)" "${kernels:-0}"
done | tee "$out/table.txt"
grep -h FAILED "$out/steps" || true
