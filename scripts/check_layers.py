#!/usr/bin/env python3
"""Checks that folders depend downwards only: cli -> train -> (models, data) -> nn -> core.

data/render stands on core's random numbers, parallelism and errors alone. Exits with 1 and names every include
that points the wrong way.
"""
import pathlib
import re
import subprocess
import sys

ALLOWED = {
    "core": {"core"},
    "nn": {"nn", "core"},
    "models": {"models", "nn", "core"},
    "data/render": {"data/render", "core"},
    "data": {"data", "data/render", "core"},
    "train": {"train", "models", "data", "data/render", "nn", "core"},
    "cli": {"cli", "train", "models", "data", "data/render", "nn", "core"},
}
RENDER_CORE = {"core/random.h", "core/parallel.h", "core/error.h"}
INCLUDE = re.compile(r'^\s*#\s*include\s+"([^"]+)"')


def layer(path):
    """The longest folder of ALLOWED that holds the path, or None (tests, bench)."""
    parts = pathlib.PurePosixPath(path).parts
    for length in (2, 1):
        name = "/".join(parts[:length])
        if len(parts) > length and name in ALLOWED:
            return name
    return None


def violations(root):
    files = subprocess.run(["git", "ls-files", "-co", "--exclude-standard", "*.h", "*.cpp"], cwd=root, check=True,
                           capture_output=True, text=True).stdout.split()
    for file in files:
        source = layer(file)
        if source is None or not (root / file).exists():
            continue
        for number, line in enumerate((root / file).read_text().splitlines(), 1):
            match = INCLUDE.match(line)
            if not match:
                continue
            target = layer(match.group(1))
            if target is None:
                yield f"{file}:{number}: includes {match.group(1)}, which is in no layer"
            elif target not in ALLOWED[source]:
                yield f"{file}:{number}: {source} must not depend on {target} ({match.group(1)})"
            elif source == "data/render" and target == "core" and match.group(1) not in RENDER_CORE:
                yield f"{file}:{number}: data/render may use {', '.join(sorted(RENDER_CORE))} of core only"


def main():
    found = list(violations(pathlib.Path(__file__).resolve().parent.parent))
    print("\n".join(found) if found else "dependencies point downwards")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
