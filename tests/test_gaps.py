"""What is missing for some frames: numbers, histories and warnings go on behind the gap."""

from tables_of_points import STILL, Body, box, driving, ids_of, results_of, street, table

import ttcvid.stages.motions as motions


def test_what_stands_in_our_way_keeps_its_number_over_a_frame_whose_way_is_not_known(monkeypatch):
    known, calls = motions.own_path, []

    def unknown_once(*args):
        calls.append(args)
        return None if len(calls) == 20 else known(*args)

    monkeypatch.setattr(motions, "own_path", unknown_once)
    stopped = Body(box((0.0, 0.5, 30.0), (1.8, 1.4, 0.3)), STILL)
    results = results_of(table([street(free_way=True), stopped], driving(10.0), n_frames=30))
    assert len(calls) == 29
    assert [ids_of(result) for result in results[16:20]] == [[1]] * 4
    assert [ids_of(result) for result in results[22:]] == [[1]] * 8
