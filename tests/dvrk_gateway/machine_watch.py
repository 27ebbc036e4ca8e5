"""Whether the machine itself stood still: a thread above all others on each core, which notes when it is late."""
import multiprocessing
import os
import queue
import time

PERIOD_S, LATE_S = 0.001, 0.001
PRIORITY = 95


def can_watch():
    """Whether the system grants SCHED_FIFO to this process. Asked in a process of its own: this one stays as it is."""
    child = os.fork()
    if child == 0:
        try:
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))
        except OSError:
            os._exit(1)
        os._exit(0)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0


def watch(core, ended, told):
    late = []
    os.sched_setaffinity(0, {core})
    os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))
    due = time.monotonic()
    while not ended.is_set():
        due += PERIOD_S
        time.sleep(max(0.0, due - time.monotonic()))
        behind = time.monotonic() - due
        if behind > LATE_S:
            now = time.time()
            late.append((now - behind, now))
            due = time.monotonic()
    told.put(late)


class MachineWatch:
    """While it lives. A core that a hypervisor takes away cannot be had back by any priority."""

    def __init__(self):
        self.ended, self.told = multiprocessing.Event(), multiprocessing.Queue()
        self.processes = [multiprocessing.Process(target=watch, args=(core, self.ended, self.told), daemon=True)
                          for core in os.sched_getaffinity(0)]
        for process in self.processes:
            process.start()

    def end(self):
        """When a core stood still for more than LATE_S: (begin, end) of each time [s since 1970], begin up to PERIOD_S late."""
        self.ended.set()
        late = sorted(one for process in self.processes for one in self.result_of(process))
        for process in self.processes:
            process.join()
        return late

    def result_of(self, process):
        """Of whichever is next; `process` is one of them, which must live as long as there is none."""
        while True:
            try:
                return self.told.get(timeout=1)
            except queue.Empty:
                if process.exitcode:
                    raise RuntimeError(f"a watcher of the machine died with code {process.exitcode}") from None
