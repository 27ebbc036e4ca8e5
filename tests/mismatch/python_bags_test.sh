#!/usr/bin/env bash
# Bags written by tools of others come in: ROS 2 by rosbags and by mcap_ros2, ROS 1 by mcap with messages of rosbags;
# uncompressed, lz4, zstd. What is exported of each is what was written.
# Needs the packages: PEER_PYTHON=/path/to/python with `pip install mcap mcap-ros2-support rosbags`; skipped without.
set -euo pipefail
here=$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)
bin=${OMENTUM_BIN:-$here/../../build/release/bin}
python=${PEER_PYTHON:-python3}
"$python" -c 'import mcap, mcap_ros2, rosbags' 2>/dev/null ||
  { echo "skipped: no Python packages mcap, mcap-ros2-support, rosbags"; exit 77; }

folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
"$python" "$here/python_bags.py" "$bin/mismatch" "$folder"
