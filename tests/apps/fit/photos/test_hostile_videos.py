"""Videos of strangers: no other file and no address is opened, and long ones are refused before they are decoded."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

import neural_renderer as nr
from neural_renderer.apps.common.pictures import ffmpeg
from neural_renderer.apps.fit.photos import video
from neural_renderer.apps.fit.photos.video import VIDEOS, choose_frames

posix = pytest.mark.skipif(os.name != "posix", reason="names of files have no colons")


@pytest.fixture(scope="module")
def clip(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("clip") / "secret.mp4"
    frames = torch.rand(12, 3, 32, 48, generator=torch.Generator().manual_seed(0))
    nr.save_animation(path, frames, fps=10)
    return path


def frames_of(path: Path) -> list[np.ndarray]:
    return [frame for *_, frame in choose_frames(path, 4, 48)]


def playlists(secret: Path) -> dict[str, str]:
    """Texts that ffmpeg takes for a list of other files."""
    hls = "#EXTM3U\n#EXT-X-VERSION:3\n#EXT-X-TARGETDURATION:1\n#EXTINF:1,\n{}\n#EXT-X-ENDLIST\n"
    dash = f"<MPD><Period><BaseURL>file://{secret}</BaseURL><AdaptationSet><Representation/></AdaptationSet></Period></MPD>"
    return {
        "hls": hls.format(secret),
        "hls, relative": hls.format(secret.name),
        "hls, master": f"#EXTM3U\n#EXT-X-STREAM-INF:BANDWIDTH=1\n{secret}\n",
        "hls, concat": hls.format(f"concat:{secret}|{secret}"),
        "hls, http": hls.format("http://127.0.0.1:9/a.mp4"),
        "ffconcat": f"ffconcat version 1.0\nfile {secret.name}\n",
        "sdp": "v=0\no=- 0 0 IN IP4 127.0.0.1\ns=x\nc=IN IP4 127.0.0.1\nt=0 0\nm=video 9 RTP/AVP 96\n",
        "dash": f'<?xml version="1.0"?>\n{dash}\n',
        "asx": f'<ASX version="3.0"><ENTRY><REF HREF="{secret}"/></ENTRY></ASX>',
        "ffmetadata": ";FFMETADATA1\ntitle=x\n",
    }


@pytest.mark.parametrize("suffix", VIDEOS)
def test_playlists_are_no_videos(clip: Path, suffix: str) -> None:
    for name, text in playlists(clip).items():
        path = clip.parent / f"list{suffix}"
        path.write_text(text)
        with pytest.raises(ValueError, match=rf"list{suffix}: expected a video, got one that cannot be read"):
            frames_of(path)
            pytest.fail(name)
        path.unlink()


def test_inputs_may_be_of_three_formats_and_local_only() -> None:
    """The options of an input stand before it."""
    arguments = ffmpeg.from_file("a.mp4", "-max_pixels", "9")
    assert arguments[:4] == ["-protocol_whitelist", "file", "-format_whitelist", "mov,matroska,avi"]
    assert arguments[-2:] == ["-i", f"file:{os.path.abspath('a.mp4')}"]


@posix
def test_names_that_look_like_addresses(clip: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """They are those of files, relative to the present folder."""
    monkeypatch.chdir(tmp_path)
    known = frames_of(clip)
    for name in ("http:a.mp4", "tcp:127.0.0.1:9.mp4", "concat:a.mp4|b.mp4", "-i.mp4", "pipe:0.mp4", "subfile,,x:y.mp4"):
        Path(name).write_bytes(clip.read_bytes())
        assert all(map(np.array_equal, frames_of(Path(name)), known))
        Path(name).unlink()
        nr.save_animation(name, torch.rand(2, 3, 8, 8))
        assert Path(name).is_file()


def test_a_long_video_is_refused_before_it_is_decoded(clip: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    runs: list[list[str]] = []

    @contextmanager
    def watched(arguments: list[str], reads: bool = False) -> Iterator[Any]:
        runs.append(list(arguments))
        with ffmpeg.running(arguments, reads) as file:
            yield file

    monkeypatch.setattr(video, "running", watched)
    assert len(frames_of(clip)) == 4
    decodes = [run for run in runs if ffmpeg.to_file(clip) in run]
    assert len(decodes) == 1, "a video is decoded once"
    runs.clear()
    for limit, value, sentence in (
        ("_MOST_FRAMES", 11, r"expected at most 11 frames and 400,000,000,000 pixels in all, got more of 48 × 32"),
        ("_MOST_PIXELS", 12 * 32 * 48 - 1, r"expected at most .* 18,431 pixels in all, got 12 of 48 × 32"),
    ):
        with monkeypatch.context() as patch:
            patch.setattr(video, limit, value)
            with pytest.raises(ValueError, match=sentence):
                frames_of(clip)
    assert not runs


def test_large_frames_are_not_decoded(clip: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Frames may be larger than the header of the file says."""
    monkeypatch.setattr(video, "_LARGEST", 32 * 48 - 1)
    with pytest.raises(ValueError, match=r"secret.mp4: expected a video, got one that cannot be read \("):
        frames_of(clip)


@posix
def test_pipes_and_folders_are_no_videos(tmp_path: Path) -> None:
    (tmp_path / "a.mp4").mkdir()
    os.mkfifo(tmp_path / "b.mp4")
    for name in ("a.mp4", "b.mp4"):
        with pytest.raises(FileNotFoundError, match="expected a video, got a"):
            frames_of(tmp_path / name)


def test_damaged_videos(clip: Path, tmp_path: Path) -> None:
    data, rng = clip.read_bytes(), np.random.default_rng(0)
    for _ in range(8):
        bad = bytearray(data)
        for place in rng.integers(0, len(data), 20):
            bad[place] = rng.integers(256)
        (tmp_path / "bad.mp4").write_bytes(bad[: rng.integers(1, len(data))] if rng.random() < 0.5 else bad)
        try:
            frames_of(tmp_path / "bad.mp4")
        except ValueError as error:
            assert "bad.mp4: expected a video" in str(error) and "\n" not in str(error)
