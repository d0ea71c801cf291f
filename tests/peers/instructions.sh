#!/usr/bin/env bash
# Counts the instructions of herd's hot paths under callgrind and holds them against instructions.json; see --help.
exec python3 "$(dirname "$0")/instructions.py" "$@"
