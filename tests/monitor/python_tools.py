#!/usr/bin/env python3
"""python_tools.py topics DOMAIN RUN: finds the types of all public topics on the bus, decodes a sample of each that flows
in a run, in the partitions "" and RUN.
python_tools.py mcap FILE: decodes every message of a recording."""
import sys
import time

FLOWING = ["omentum/policy/weights", "omentum/rollout/segment", "omentum/worker/status", "omentum/learner/status",
           "omentum/episode/summary", "omentum/run/manifest"]
QUIET = ["omentum/control/command", "omentum/control/reply", "omentum/sim/frame",
         "omentum/robot/state"]
LONGEST_S = 60


def types_on_the_bus(participant):
    from cyclonedds.builtin import BuiltinDataReader, BuiltinTopicDcpsPublication
    from cyclonedds.dynamic import get_types_for_typeid
    from cyclonedds.util import duration
    reader = BuiltinDataReader(participant, BuiltinTopicDcpsPublication)
    found, end = {}, time.time() + LONGEST_S
    while time.time() < end and set(FLOWING + QUIET) - set(found):
        for sample in reader.take(N=100):
            name = getattr(sample, "topic_name", "")
            if name in FLOWING + QUIET and name not in found and sample.type_id is not None:
                found[name] = get_types_for_typeid(participant, sample.type_id, duration(seconds=10))[0]
        time.sleep(0.05)
    return found


def read_topics(domain, run):
    from cyclonedds.core import Policy, Qos
    from cyclonedds.domain import DomainParticipant
    from cyclonedds.sub import DataReader, Subscriber
    from cyclonedds.topic import Topic
    from cyclonedds.util import duration
    participant = DomainParticipant(domain)
    types = types_on_the_bus(participant)
    missing = set(FLOWING + QUIET) - set(types)
    if missing:
        sys.exit(f"no type of {', '.join(sorted(missing))}")
    topics = {name: Topic(participant, name, data_type) for name, data_type in types.items()}
    for partition in ("", run):
        subscriber = Subscriber(participant, Qos(Policy.Partition([partition])))
        late = Qos(Policy.Durability.TransientLocal, Policy.Reliability.Reliable(duration(seconds=1)))
        readers = {name: DataReader(subscriber, topic, late if name == "omentum/run/manifest" else None)
                   for name, topic in topics.items()}
        waiting, end = set(FLOWING), time.time() + LONGEST_S
        while waiting and time.time() < end:
            for name in sorted(waiting):
                # A sample without data tells of a worker or learner that ended.
                samples = [s for s in readers[name].take(N=8) if s.sample_info.valid_data]
                if samples:
                    print(f"partition \"{partition}\": {name}: {type(samples[0]).__name__} with "
                          f"{len(samples[0].__annotations__)} members")
                    waiting.discard(name)
            time.sleep(0.02)
        if waiting:
            sys.exit(f"partition \"{partition}\": nothing of {', '.join(sorted(waiting))}")
    print(f"{len(types)} types known, {len(FLOWING)} topics decoded in both partitions")


def read_mcap(path):
    from mcap.reader import make_reader
    from mcap_protobuf.decoder import DecoderFactory
    counts = {}
    with open(path, "rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        channels = {channel.topic for channel in reader.get_summary().channels.values()}
        for schema, channel, _, message in reader.iter_decoded_messages():
            counts[channel.topic] = counts.get(channel.topic, 0) + 1
            if channel.topic == "omentum/rollout/segment" and len(message.rewards) != message.steps:
                sys.exit("a segment lacks rewards")
    if channels != set(FLOWING + QUIET):
        sys.exit(f"channels {sorted(channels)}")
    for topic in FLOWING:
        if not counts.get(topic):
            sys.exit(f"no message of {topic}")
    print("mcap: " + ", ".join(f"{topic} {count}" for topic, count in sorted(counts.items())))


if __name__ == "__main__":
    if sys.argv[1] == "topics":
        read_topics(int(sys.argv[2]), sys.argv[3])
    else:
        read_mcap(sys.argv[2])
