#!/usr/bin/env bash
# The README's picture: the review of the newest run in runs/quarry as Rerun shows it, on a virtual screen.
# Called by `make screenshots`, which puts .venv/bin on PATH. Makes the run first if there is none.
set -euo pipefail
cd "$(dirname "$0")/.."

runs=runs/quarry
picture=docs/images/review.png
largest_bytes=400000

fail() {
    echo "screenshots: $*" >&2
    exit 2
}

command -v malipp >/dev/null || fail "malipp is not on PATH; run: make screenshots"
command -v xvfb-run >/dev/null || fail "a virtual screen is missing; on Debian or Ubuntu: apt-get install xvfb"
if [[ -z "${VK_ICD_FILENAMES:-}" ]]; then
    driver=$(find /usr/share/vulkan/icd.d -name 'lvp_icd*.json' -print -quit 2>/dev/null || true)
    [[ -n "$driver" ]] ||
        fail "a software Vulkan driver is missing; on Debian or Ubuntu: apt-get install mesa-vulkan-drivers"
    export VK_ICD_FILENAMES="$driver"
fi

newest() {
    find "$runs" -name '*.mcap' -printf '%T@ %p\n' 2>/dev/null | sort -rn | head -n 1 | cut -d ' ' -f 2-
}

recording=$(newest)
if [[ -z "$recording" ]]; then
    echo "No run in $runs yet: making one ..."
    malipp run missions/quarry.yaml --output "$runs"
    recording=$(newest)
    [[ -n "$recording" ]] || fail "the run left no .mcap file in $runs"
fi

work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python -c '
import sys
from pathlib import Path
from malipp_field.review import review
review(Path(sys.argv[1]), Path(sys.argv[2]))' "$recording" "$work/review.rrd"

# The mouse pointer waits in the middle of the screen: on a screen this large that is outside the window, and
# nothing is hovered over.
echo "Drawing $recording (half a minute) ..."
timeout 180 xvfb-run --auto-servernum --server-args '-screen 0 6400x4000x24' \
    rerun "$work/review.rrd" --bind 127.0.0.1 --port auto \
    --window-size 1400x900 --screenshot-to "$work/review.png" >"$work/rerun.log" 2>&1 ||
    fail "Rerun could not draw it: $(grep -v '^$' "$work/rerun.log" | tail -n 1)"
[[ -s "$work/review.png" ]] || fail "Rerun left no picture: $(tail -n 1 "$work/rerun.log")"

mkdir -p "$(dirname "$picture")"
python -c '
import sys
from pathlib import Path
from PIL import Image
drawn = Image.open(sys.argv[1]).convert("RGB")
for width in range(1400, 900, -50):  # in full colour: a palette would draw steps into the field images
    size = (width, width * drawn.height // drawn.width)
    drawn.resize(size, Image.Resampling.LANCZOS).save(sys.argv[2], optimize=True)
    if Path(sys.argv[2]).stat().st_size <= int(sys.argv[3]):
        break' "$work/review.png" "$picture" "$largest_bytes"

bytes=$(wc -c <"$picture")
((bytes <= largest_bytes)) || fail "$picture has $bytes bytes, more than $largest_bytes"
echo "$picture ($((bytes / 1000)) kB)"
