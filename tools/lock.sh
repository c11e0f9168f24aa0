#!/usr/bin/env bash
# Rewrite every lock. Called by `make lock`, which sees to .tools/bin/uv first.
# One set of pins for every Python from 3.11 and for x86_64 and aarch64; hashes of all files; no index addresses.
set -euo pipefail
cd "$(dirname "$0")/.."

compile() {
    .tools/bin/uv pip compile --quiet --no-config --universal --python "$(command -v "${PYTHON:-python3}")" \
        --python-version 3.11 --fork-strategy fewest --generate-hashes --no-header \
        --no-emit-index-url --no-emit-find-links ${UPGRADE:+--upgrade} "$@"
}

compile tools/uv.in --output-file tools/uv.txt
compile requirements/build.in --output-file requirements/build.lock
compile requirements/dist.in --output-file requirements/dist.lock
compile requirements/browser.in --output-file requirements/browser.lock
# The hand's own lock comes out of the full one, so that what is tested is what is installed there.
compile pyproject.toml --all-extras --group dev --constraint requirements/build.lock \
    --output-file requirements/dev.lock
compile pyproject.toml --constraint requirements/dev.lock --output-file requirements/live.lock
compile pyproject.toml --extra train --extra viz --constraint requirements/dev.lock \
    --output-file requirements/demo.lock
# Only what an environment of dev.lock lacks: the environments of peers and docs are built from both.
locked=$(sed -n 's/^\([A-Za-z0-9][A-Za-z0-9._-]*\)==.*/--no-emit-package \1/p' requirements/dev.lock)
# shellcheck disable=SC2086
compile requirements/peers.in --constraint requirements/dev.lock $locked --output-file requirements/peers.lock
# The site needs what dev.lock has for other systems only: colorama.
locked=$(sed -n 's/^\([A-Za-z0-9][A-Za-z0-9._-]*\)==[^;]*$/--no-emit-package \1/p' requirements/dev.lock)
# shellcheck disable=SC2086
compile requirements/docs.in --constraint requirements/dev.lock $locked --output-file requirements/docs.lock

if grep -nE '://|--(extra-)?index-url|--find-links' tools/uv.txt requirements/*.lock; then
    echo "a lock names an index: remove the lines above" >&2
    exit 1
fi
