"""Threads that read ahead and write later: bounded queues, preserved order, and no deadlock after an interruption."""

import signal
import threading
import time
from collections.abc import Generator, Iterator

import pytest

from l3cli.errors import InputFileError
from l3cli.parallel import threads
from l3cli.parallel.threads import BackgroundTask, WriteBehind, prefetched
from l3cli.system import signals
from tests.helpers.hostile import HANGS, timed


def test_reading_runs_ahead_no_further_than_asked() -> None:
    made: list[int] = []

    def numbers() -> Iterator[int]:
        for number in range(1000):
            made.append(number)
            yield number

    taken = prefetched(numbers(), 3)
    assert isinstance(taken, Generator)
    for number in range(10):
        assert next(taken) == number
        time.sleep(0.01)
        assert len(made) <= number + 1 + 3
    taken.close()
    before = threading.active_count()
    time.sleep(0.05)
    assert len(made) < 20
    assert threading.active_count() <= before


def test_writing_falls_behind_no_further_than_asked() -> None:
    gate, written = threading.Event(), []

    def slow(item: int) -> None:
        gate.wait()
        written.append(item)

    put = []
    writing = WriteBehind(slow, 3)

    def fill() -> None:
        with writing:
            for number in range(10):
                writing.put(number)
                put.append(number)

    filler = threading.Thread(target=fill)
    filler.start()
    time.sleep(0.05)
    waiting = len(put)
    gate.set()
    filler.join()
    assert waiting <= 3 + 1
    assert written == list(range(10))


def test_errors_cross_threads() -> None:
    def broken() -> Iterator[int]:
        yield 1
        raise InputFileError("broken")

    items = prefetched(broken(), 2)
    assert next(items) == 1
    with pytest.raises(InputFileError, match="broken"):
        next(items)

    def fails(item: int) -> None:
        raise InputFileError(f"item {item}")

    def put_many(writing: WriteBehind) -> None:
        with writing:
            for number in range(50):
                writing.put(number)

    with pytest.raises(InputFileError, match="item 0"):
        put_many(WriteBehind(fails, 2))


def test_work_done_during_it_ends_with_the_block_and_leaves_its_errors_to_others() -> None:
    begun, done = threading.Event(), threading.Event()

    def work() -> None:
        begun.set()
        time.sleep(0.05)
        done.set()
        raise InputFileError("said where it is needed")

    with BackgroundTask(work):
        assert begun.wait(300)
        assert not done.is_set()
    assert done.is_set()
    done.clear()
    with pytest.raises(KeyboardInterrupt), BackgroundTask(work):
        raise KeyboardInterrupt
    assert done.is_set()  # a thread that imports a library when the program ends could abort it


def test_a_failing_block_still_writes_what_was_put_an_interrupted_one_does_not() -> None:
    for error, count in ((InputFileError, 3), (KeyboardInterrupt, 1)):
        gate = threading.Event()
        written: list[int] = []

        def slow(item: int, gate: threading.Event = gate, written: list = written) -> None:
            gate.wait()
            written.append(item)

        def stopped(writing: WriteBehind, error: type = error, gate: threading.Event = gate) -> None:
            with writing:
                for number in range(3):
                    writing.put(number)
                time.sleep(0.05)
                threading.Timer(0.05, gate.set).start()
                raise error

        with pytest.raises(error):
            stopped(WriteBehind(slow, 3))
        assert written == list(range(count))


def test_an_interrupt_while_the_last_items_are_waited_for_drops_what_waits() -> None:
    """What is being done is done: a thread at work when the program ends could abort it."""
    main_thread = threading.main_thread().ident
    assert main_thread is not None
    written: list[int | str] = []

    both = threading.Barrier(2)

    def slow(item: int) -> None:
        both.wait()  # two items are being written
        if item == 0:
            time.sleep(0.1)
            signal.pthread_kill(main_thread, signal.SIGINT)
        time.sleep(0.2)
        written.append(item)

    def interrupted() -> None:
        with WriteBehind(slow, 3, threads=2) as writing:
            for number in range(4):
                writing.put(number)
        written.append("taken for all")
        time.sleep(60)

    before = {each: signal.signal(each, signals.end) for each in (signal.SIGINT, signal.SIGTERM)}
    try:
        with pytest.raises(KeyboardInterrupt):
            interrupted()
    finally:
        for each, handler in before.items():
            signal.signal(each, handler)
    assert sorted(written, key=str) == [0, 1]


def test_what_never_ends_is_not_waited_for_after_an_interrupt(monkeypatch: pytest.MonkeyPatch) -> None:
    """As when nobody reads the pipe that is written to."""
    monkeypatch.setattr(threads, "WRITE_SECONDS", 0.2)
    begun, gate = threading.Event(), threading.Event()

    def stuck(item: int) -> None:
        begun.set()
        gate.wait()

    def interrupted() -> None:
        with WriteBehind(stuck, 3) as writing:
            writing.put(0)
            begun.wait()
            raise KeyboardInterrupt

    try:
        with timed(HANGS), pytest.raises(KeyboardInterrupt):
            interrupted()
    finally:
        gate.set()


@pytest.mark.parametrize("number", [1, 2, 3])
def test_many_threads_end(number: int) -> None:
    for count in (0, 1, 5):
        written: list[int] = []
        with WriteBehind(written.append, 2, number) as writing:
            for item in range(count):
                writing.put(item)
        assert sorted(written) == list(range(count))
