#!/usr/bin/env bash
# Makes the images of docs/images/ that show data: a contact sheet, example scenes, and, where Chromium is installed,
# the page of check-data. About two minutes of a core. Look at them before committing.
set -euo pipefail
cd "$(dirname "$0")/.."
opaline=$PWD/build/release/opaline
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT

"$opaline" render configs/quick.toml --set render.train=48 --set render.test=8 --contact-sheet 6 --out "$work/set"
cp "$work/set/contact_sheet.png" docs/images/contact_sheet.png

"$opaline" render configs/quick.toml --set render.seed=11 --set render.train=2 --set render.test=0 \
  --set render.size=96 --set render.spp=256 --contact-sheet 0 --out "$work/scenes"
"$opaline" check-data "$work/scenes" --contact-sheet docs/images/scenes.png

if command -v chromium > /dev/null; then
  (cd "$work" && "$opaline" check-data set --html check.html)
  chromium --headless --no-sandbox --disable-gpu --hide-scrollbars --window-size=1100,770 \
    --screenshot="$PWD/docs/images/check_data.png" "file://$work/check.html" 2> /dev/null
fi
ls -l docs/images
