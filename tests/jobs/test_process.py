"""Settings of the whole process."""

import ctypes
import gc
import subprocess
import sys

import cv2
import pytest

from ttcvid.jobs.process import one_opencv_thread, quick_thread_switches, rare_garbage_collections


def test_opencv_has_one_thread_inside_and_its_own_number_afterwards():
    before = cv2.getNumThreads()
    with one_opencv_thread():
        assert cv2.getNumThreads() == 1
    assert cv2.getNumThreads() == before


def test_garbage_is_collected_rarely_inside_and_as_before_afterwards():
    before = gc.get_threshold()
    with rare_garbage_collections():
        assert gc.get_threshold()[0] > 10 * before[0]
    assert gc.get_threshold() == before


def test_threads_switch_quickly_inside_and_at_their_own_pace_afterwards():
    before_s = sys.getswitchinterval()
    with quick_thread_switches():
        assert sys.getswitchinterval() < 0.2 * before_s
    assert sys.getswitchinterval() == before_s


@pytest.mark.skipif(not hasattr(ctypes.CDLL(None), "mallopt"), reason="needs glibc")
def test_buffers_of_pictures_are_taken_again_without_fresh_pages():
    """In a process and a thread of their own: the setting stays, and threads have memory of their own."""
    script = """
import resource, threading
import numpy as np
from ttcvid.jobs.process import share_freed_memory

def work():
    counts = []
    for _ in range(5):
        pictures = [np.ones((500, 1000), np.float32) for _ in range(20)]
        del pictures
        counts.append(resource.getrusage(resource.RUSAGE_THREAD).ru_minflt)
    print(counts[-1] - counts[1])

share_freed_memory()
thread = threading.Thread(target=work)
thread.start()
thread.join()
"""
    run = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    n_fresh_pages_of_three_rounds = int(run.stdout)
    assert n_fresh_pages_of_three_rounds < 1000  # of 29 000
