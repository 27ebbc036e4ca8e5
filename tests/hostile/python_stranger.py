#!/usr/bin/env python3
"""A participant of the Python package cyclonedds that is neither learner nor worker of a run and forges what both send.

usage: python_stranger.py RUN DOMAIN SECONDS     (CYCLONEDDS_URI from `learner --print-dds-env`)

Copies every segment with other rewards and a right CRC, every policy with other parameters (right hash) and with a
higher epoch (wrong hash), and writes tasks into every worker's partition. The types are those that it discovers, so it
also shows that generic Python tools can name them. Prints how many of each it sent; exit code 1 when it could send none
of a kind.
"""
import dataclasses
import hashlib
import struct
import sys
import time

from cyclonedds.builtin import BuiltinDataReader, BuiltinTopicDcpsPublication
from cyclonedds.core import Policy, Qos
from cyclonedds.domain import DomainParticipant
from cyclonedds.dynamic import get_types_for_typeid
from cyclonedds.pub import DataWriter, Publisher
from cyclonedds.sub import DataReader, Subscriber
from cyclonedds.topic import Topic
from cyclonedds.util import duration

# The numbers and arrays that the CRC covers, in the order of core/segment_fields.h.
NUMBERS = """slot segment task_hash policy_version steps end_episode end_episode_step end_episode_limit state_format
    end_hash failed physics_ticks""".split()
ARRAYS = [tuple(word.split(":")) for word in """observations:f actions:B actions_continuous:f log_probs:f rewards:f
    values:f flags:B bootstrap_observation:f final_observations:f episode_end_step:I episode_return:d episode_length:I
    episode_outcome:B episode_exposure:f episode_grasped:B episode_held:B episode_grasp_position_in_world_m:f
    episode_start_position_in_world_m:f end_state:B state_hashes:Q frame_positions_in_world_m:f
    tool_positions_in_world_m:f exposures:f""".split()]


def crc32c_table():
    table = []
    for byte in range(256):
        for _ in range(8):
            byte = byte >> 1 ^ (0x82F63B78 if byte & 1 else 0)
        table.append(byte)
    return table


TABLE = crc32c_table()


def crc32c(data):
    crc = 0xFFFFFFFF
    for byte in data:
        crc = crc >> 8 ^ TABLE[(crc ^ byte) & 255]
    return crc ^ 0xFFFFFFFF


def pack(kind, values):
    return struct.pack(f"<{len(values)}{kind}", *values)


def segment_crc(segment):
    data = b"".join(struct.pack("<Q", getattr(segment, name)) for name in NUMBERS)
    return crc32c(data + b"".join(pack(kind, getattr(segment, name)) for name, kind in ARRAYS))


def weights_hash(weights):
    data = struct.pack("<QQ", len(weights.parameters), len(weights.obs_mean))
    for values in (weights.parameters, weights.obs_mean, weights.obs_inv_std):
        data += pack("f", values)
    return hashlib.sha256(data).digest()


class Stranger:
    def __init__(self, run, domain):
        self.run = run
        self.participant = DomainParticipant(domain)
        self.publications = BuiltinDataReader(self.participant, BuiltinTopicDcpsPublication)
        self.topics, self.readers, self.writers, self.sent = {}, {}, {}, {}

    def discover(self):
        for publication in self.publications.take(N=100):
            name = publication.topic_name
            if name is None or not name.startswith("omentum/") or name in self.topics or publication.type_id is None:
                continue
            kind, _ = get_types_for_typeid(self.participant, publication.type_id, duration(seconds=2))
            self.topics[name] = Topic(self.participant, name, kind, qos=publication.qos)

    def reader(self, name):
        if name not in self.readers and name in self.topics:
            partition = Subscriber(self.participant, Qos(Policy.Partition([self.run])))
            self.readers[name] = DataReader(partition, self.topics[name], qos=self.topics[name].get_qos())
        return self.readers.get(name)

    def take(self, name):
        reader = self.reader(name)
        if reader is None:
            return []
        return [sample for sample in reader.take(N=100) if dataclasses.is_dataclass(sample)]

    def write(self, name, partition, sample):
        key = name, partition
        if key not in self.writers:
            publisher = Publisher(self.participant, Qos(Policy.Partition([partition])))
            self.writers[key] = DataWriter(publisher, self.topics[name], qos=self.topics[name].get_qos())
        self.writers[key].write(sample)
        self.sent[name] = self.sent.get(name, 0) + 1

    def forge(self):
        for segment in self.take("omentum/rollout/segment"):
            segment.rewards = [1.0] * len(segment.rewards)
            if segment.payload_crc32c == segment_crc(segment):
                continue  # its own echo
            segment.payload_crc32c = segment_crc(segment)
            self.write("omentum/rollout/segment", self.run, segment)
        for weights in self.take("omentum/policy/weights"):
            if weights.published_at_ns == 0:
                continue
            weights.published_at_ns = 0
            weights.parameters = [p + 0.25 for p in weights.parameters]
            weights.parameters = list(struct.unpack(f"<{len(weights.parameters)}f", pack("f", weights.parameters)))
            weights.weights_hash = list(weights_hash(weights))
            self.write("omentum/policy/weights", self.run, weights)
            weights.learner_epoch += 1000
            weights.weights_hash = [byte ^ 255 for byte in weights.weights_hash]
            self.write("omentum/policy/weights", self.run, weights)
        task_type = self.topics.get("omentum/rollout/task")
        for status in self.take("omentum/worker/status"):
            if task_type is None:
                continue
            task = self.empty(task_type.data_type)
            task.worker_id, task.learner_epoch = status.worker_id, status.learner_epoch
            task.steps, task.reset, task.config_hash = 32, True, 1
            self.write("omentum/rollout/task", f"{self.run}/w{status.worker_id}", task)

    @staticmethod
    def empty(kind):
        """A record whose numbers are 0 and whose lists are empty."""
        values = {}
        for field in dataclasses.fields(kind):
            text = str(field.type)
            if "sequence" in text:
                values[field.name] = []
            elif "bool" in text:
                values[field.name] = False
            elif isinstance(field.type, type) and hasattr(field.type, "__members__"):
                values[field.name] = list(field.type)[0]
            else:
                values[field.name] = 0
        return kind(**values)


def main():
    run, domain, seconds = sys.argv[1], int(sys.argv[2]), float(sys.argv[3])
    stranger = Stranger(run, domain)
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        stranger.discover()
        stranger.forge()
        time.sleep(0.005)
    print(" ".join(f"{name}={count}" for name, count in sorted(stranger.sent.items())))
    wanted = {"omentum/rollout/segment", "omentum/policy/weights", "omentum/rollout/task"}
    sys.exit(0 if wanted <= stranger.sent.keys() else 1)


if __name__ == "__main__":
    main()
