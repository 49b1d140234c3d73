"""Settings of the whole process."""

import gc
import sys

import cv2

from ttcvid.jobs.processes.threads import one_opencv_thread, quick_thread_switches, rare_garbage_collections


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
