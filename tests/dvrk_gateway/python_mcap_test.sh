#!/usr/bin/env bash
# A tool of others opens a recording of a robot: the Python package mcap decodes every message of a converted wire log.
# Needs the packages: PEER_PYTHON=/path/to/python with `pip install mcap mcap-protobuf-support`; skipped without.
set -euo pipefail
here=$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)
bin=${OMENTUM_BIN:-$here/../../build/release/bin}
python=${PEER_PYTHON:-python3}
"$python" -c 'import mcap, mcap_protobuf' 2>/dev/null ||
  { echo "skipped: no Python packages mcap, mcap-protobuf-support"; exit 77; }

folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cat "$here"/../fuzz/corpus/recording/{wire,poses}.tsv | grep -v '^no tab' | sort -n > "$folder/log.tsv"
"$bin/dvrk_gateway" convert "$folder/log.tsv" -o "$folder/log.mcap"
"$python" - "$folder/log.mcap" <<'END'
import sys
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

messages = {}
with open(sys.argv[1], "rb") as file:
    for _, channel, message, decoded in make_reader(file, decoder_factories=[DecoderFactory()]).iter_decoded_messages():
        messages.setdefault(channel.topic, []).append((message.log_time, decoded))
if messages["/recording"][0][1].mode != "convert":
    sys.exit("/recording does not say what it is")
time_ns, pose = messages["/tool"][0]
if time_ns != 100_000_000 or pose.frame_id != "W" or abs(pose.pose.position.z + 0.1 - 0.0102) > 1e-12:
    sys.exit(f"/tool is {pose} at {time_ns}")
time_ns, joints = messages["/joints_commanded"][-1]
if time_ns != 510_000_000 or [joint.name for joint in joints.joints][2] != "insertion" or joints.joints[2].position != 0.15:
    sys.exit(f"/joints_commanded is {joints} at {time_ns}")
if messages["/jaw"][-1][1].commanded_rad != 0.5 or messages["/robot_state"][-1][1].state != "FAULT":
    sys.exit("/jaw or /robot_state differ")
print(", ".join(f"{topic} {len(found)}" for topic, found in sorted(messages.items())))
END
