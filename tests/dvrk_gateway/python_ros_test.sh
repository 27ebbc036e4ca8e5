#!/usr/bin/env bash
# The Python package cyclonedds reads the ROS 2 topics of the gateway, with types of its own.
# Needs the package: PEER_PYTHON=/path/to/python with `pip install cyclonedds==11.0.1`; skipped without.
set -euo pipefail
here=$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)
bin=${OMENTUM_BIN:-$here/../../build/release/bin}
python=${PEER_PYTHON:-python3}
"$python" -c 'import cyclonedds' 2>/dev/null || { echo "skipped: no Python package cyclonedds"; exit 77; }
eval "$("$bin/learner" --print-dds-env)"
exec "$python" "$here/ros_reader.py" "$bin"
