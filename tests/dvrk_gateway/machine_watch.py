"""Whether the machine itself stood still: a thread above all others on each core, which notes when it is late."""
import multiprocessing
import os
import time

PERIOD_S, LATE_S = 0.005, 0.005
PRIORITY = 95


def watch(core, ended, late):
    os.sched_setaffinity(0, {core})
    os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))
    due = time.monotonic()
    while not ended.is_set():
        due += PERIOD_S
        time.sleep(max(0.0, due - time.monotonic()))
        behind = time.monotonic() - due
        if behind > LATE_S:
            with late.get_lock():
                late[0] += 1
                late[1] = max(late[1], 1e3 * behind)
            due = time.monotonic()


class MachineWatch:
    """While it lives. A core that a hypervisor takes away cannot be had back by any priority."""

    def __init__(self):
        self.ended, self.late = multiprocessing.Event(), multiprocessing.Array("d", 2)
        self.processes = [multiprocessing.Process(target=watch, args=(core, self.ended, self.late), daemon=True)
                          for core in os.sched_getaffinity(0)]
        for process in self.processes:
            process.start()

    def end(self):
        """How often a core stood still for more than 5 ms, and the longest time [ms]."""
        self.ended.set()
        for process in self.processes:
            process.join()
        return int(self.late[0]), self.late[1]
