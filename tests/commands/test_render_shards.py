"""`l3 render --shard`: separately rendered parts of a sequence equal the pictures of a single run."""

from pathlib import Path

import numpy as np
import pytest

from l3cli.io.video import pyav
from l3cli.rendering.temporal import chunks
from l3cli.stages.rendering.job import part_of
from tests.helpers.calls import L3, Refused
from tests.helpers.sequences import FAST, filtered_places
from tests.helpers.still_scene import COUNT, mosaics


def files(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.glob("[!.]*")}


@pytest.mark.parametrize("exposure", ["auto", "0.8"])
def test_shards_are_the_pictures_of_one_run(
    l3: L3, tmp_path: Path, still_table: Path, still_frames: Path, monkeypatch: pytest.MonkeyPatch, exposure: str
) -> None:
    """Filtered in time, into one folder; each shard filters its frames and those that they depend on, and no others."""
    monkeypatch.setattr(chunks, "CHUNK", 4)
    monkeypatch.setattr(chunks, "LEAD", 1)
    call = ("render", still_table, still_frames, "--temporal", "--exposure", exposure, *FAST)
    assert l3(*call, "-o", tmp_path / "whole")[0] == 0
    taken = filtered_places(monkeypatch)
    for number, expected in ((2, [*range(6)]), (3, [*range(3, COUNT)]), (1, [*range(3)])):
        taken.clear()
        assert l3(*call, "-o", tmp_path / "out", "--shard", f"{number}/3") == (0, "", "")
        assert taken == expected
    assert files(tmp_path / "out") == files(tmp_path / "whole")


def test_a_shard_goes_on_where_it_was_stopped(l3: L3, tmp_path: Path, still_table: Path, still_frames: Path) -> None:
    call = ("render", still_table, still_frames, "-o", tmp_path / "out", "--temporal", *FAST)
    content = (still_frames / "frame_7.tif").read_bytes()
    (still_frames / "frame_7.tif").write_bytes(b"")
    assert l3(*call, "--shard", "1/2") == (0, "", "")
    assert l3(*call, "--shard", "2/2")[0] == 3
    (still_frames / "frame_7.tif").write_bytes(content)
    assert "frame_4.tif" in "".join(path.name for path in still_frames.iterdir())
    assert "exists; add --force" in l3(*call, "--shard", "1/2")[2]
    assert (tmp_path / "out/.2-of-2.l3-unfinished").exists()
    assert l3(*call, "--shard", "2/2", "--resume") == (0, "", "")
    assert l3(*call[:4], tmp_path / "whole", *call[5:])[0] == 0
    assert files(tmp_path / "out") == files(tmp_path / "whole")


def test_broken_frames_of_other_shards_are_theirs(l3: L3, tmp_path: Path, still_table: Path, still_frames: Path) -> None:
    (still_frames / "frame_2.tif").write_bytes(b"")
    call = ("render", still_table, still_frames, "-o", tmp_path / "out", "--temporal", "--skip-bad", *FAST, "--shard")
    code, _, err = l3(*call, "2/2")
    assert (code, "frame_2.tif" in err) == (0, False)
    code, _, err = l3(*call, "1/2")
    assert (code, "1 of 4 frames failed and were skipped" in err) == (1, True)
    assert len(files(tmp_path / "out")) == COUNT - 1


def test_streams_of_a_known_length_and_videos_are_divided(l3: L3, tmp_path: Path, still_table: Path) -> None:
    np.save(tmp_path / "stack.npy", mosaics())
    call = ("render", still_table, tmp_path / "stack.npy", "--exposure", "0.8", *FAST)
    for name, options in (("whole", ()), ("one", ("--shard", "1/2")), ("two", ("--shard", "2/2"))):
        assert l3(*call, "-o", tmp_path / f"{name}.y4m", *options)[0] == 0
    whole, one, two = ((tmp_path / f"{name}.y4m").read_bytes() for name in ("whole", "one", "two"))
    head = whole.index(b"FRAME")
    assert whole == one + two[head:]
    assert whole[:head] == two[:head]


def test_wrong_shards_are_one_line(l3: L3, tmp_path: Path, still_table: Path, still_frames: Path, refused: Refused) -> None:
    call = ("render", still_table, still_frames, "-o", tmp_path / "out", *FAST)
    assert "9 frames, but --shard divides it into 10 shards" in refused(2, *call, "--shard", "1/10")
    assert "use a shard from 1/2 to 2/2" in refused(2, *call, "--shard", "3/2")
    missing = ("render", still_table, tmp_path / "missing", "-o", tmp_path / "out", *FAST)
    assert "missing does not exist" in refused(3, *missing, "--shard", "1/2")
    several = ("render", still_table, still_frames, still_frames, "-o", tmp_path / "out", *FAST)
    assert "--shard works only for one sequence" in refused(2, *several, "--shard", "1/2")
    stream = ("render", still_table, "-", "-o", tmp_path / "out", "--size", "40x52", *FAST)
    assert "does not state its number of frames, which --shard needs; set --frames" in refused(2, *stream, "--shard", "1/2")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("count", [1000, 1079, 1080, 1200, 1201, 4999])
def test_shards_of_long_sequences_begin_with_chunks(count: int) -> None:
    from l3cli.io.sequences import FrameSequence

    sequence = FrameSequence("clip", None, count, stills=False)  # type: ignore[arg-type]
    parts = [part_of(sequence, (number, 4), temporal=True) for number in range(1, 5)]
    assert [place for part in parts for place in part] == [*range(count)]
    assert all(parts)
    assert all(part.start % 240 == 0 for part in parts)
    assert part_of(sequence, (2, 4), temporal=False).start == count // 4
    assert part_of(sequence, (2, 5), temporal=True).start % 240 == (0 if count >= 1200 else count // 5)


def test_parts_of_a_video_join_to_the_frames_of_one_run(
    l3: L3, tmp_path: Path, still_table: Path, still_frames: Path
) -> None:
    """By the concat demuxer of the libraries of ffmpeg, with the packets copied, as docs/commands.md does it."""
    call = ("render", still_table, still_frames, "--exposure", "0.8", *FAST)
    assert l3(*call, "-o", tmp_path / "whole.mkv")[0] == 0
    for number in (1, 2, 3):
        assert l3(*call, "-o", tmp_path / f"part_{number}.mkv", "--shard", f"{number}/3")[0] == 0
    (tmp_path / "parts.txt").write_text("".join(f"file '{tmp_path}/part_{number}.mkv'\n" for number in (1, 2, 3)))
    av = pyav()
    with (
        av.open(str(tmp_path / "parts.txt"), format="concat", options={"safe": "0"}) as parts,
        av.open(str(tmp_path / "clip.mkv"), "w") as clip,
    ):
        copy = clip.add_stream_from_template(parts.streams.video[0])
        for packet in parts.demux(video=0):
            if packet.dts is not None:
                packet.stream = copy
                clip.mux(packet)

    def shown(name: str) -> tuple[list[int], list[bytes]]:
        with av.open(str(tmp_path / name)) as video:
            decoded = list(video.decode(video=0))
        return [frame.pts for frame in decoded], [frame.to_ndarray(format="rgb24").tobytes() for frame in decoded]

    assert len(shown("whole.mkv")[0]) == COUNT
    assert shown("clip.mkv") == shown("whole.mkv")
