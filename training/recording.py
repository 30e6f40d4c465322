"""Frames to a picture or a film, one frame in memory at a time."""

from __future__ import annotations

import importlib.util
import os
from collections.abc import Iterator
from itertools import chain
from pathlib import Path

import numpy as np
from gymnasium.error import DependencyNotInstalled
from numpy.typing import NDArray

__all__ = ["SUFFIXES", "best_suffix", "record"]

Frame = NDArray[np.uint8]
SUFFIXES = (".mp4", ".gif", ".png")
_HOLD_S = 1.5
"""The last frame of a film stays this long."""


def best_suffix() -> str:
    """What can be written here: a film if its encoder is there, else an animated picture."""
    return ".mp4" if importlib.util.find_spec("imageio_ffmpeg") else ".gif"


def record(path: Path, frames: Iterator[Frame], fps: float) -> int:
    """Write frames as they come; the file appears when it is complete.

    Args:
        path: .mp4 or .gif: all frames; .png: the last one.
        frames: (H, W, 3) each, all of one size; at least one.
        fps: frames per second.

    Returns:
        number of frames.

    Raises:
        ValueError: another ending, or no frame.
        DependencyNotInstalled: what writes this kind of file is not there.
        OSError: the file cannot be written.
    """
    writers = {".mp4": _write_mp4, ".gif": _write_gif, ".png": _write_png}
    write = writers.get(path.suffix.lower())
    if write is None:
        raise ValueError(f"record: path must end in {', '.join(writers)}; got {path.name}. Use {path.stem}.mp4.")
    first = next(frames, None)
    if first is None:
        raise ValueError("record: frames must hold at least one; got none. Reset the environment first.")
    count = 0

    def counted() -> Iterator[Frame]:
        nonlocal count
        for frame in chain([first], frames):
            count += 1
            yield frame

    part = path.with_name(f".{path.stem}.{os.getpid()}.part{path.suffix}")
    try:
        write(part, counted(), fps)
        part.replace(path)
    finally:
        part.unlink(missing_ok=True)
    return count


def _missing(name: str, kind: str) -> DependencyNotInstalled:
    return DependencyNotInstalled(
        f"record: {name} must be installed to write a {kind}; got none. Run pip install 'jink[render]'."
    )


def _write_mp4(path: Path, frames: Iterator[Frame], fps: float) -> None:
    try:
        import imageio_ffmpeg
    except ImportError as error:
        raise _missing("imageio-ffmpeg", ".mp4") from error
    writer, last = None, None
    try:
        for last in frames:
            if writer is None:
                height, width = last.shape[:2]
                writer = imageio_ffmpeg.write_frames(
                    str(path), (width, height), fps=fps, codec="libx264", quality=8, macro_block_size=2
                )
                writer.send(None)
            writer.send(last)
        if writer is not None and last is not None:
            for _ in range(round(_HOLD_S * fps)):
                writer.send(last)
    finally:
        if writer is not None:
            writer.close()


def _write_gif(path: Path, frames: Iterator[Frame], fps: float) -> None:
    try:
        from PIL import Image
    except ImportError as error:
        raise _missing("pillow", ".gif") from error
    # 64 colours per frame keep lines smooth; dithering would make flat areas crawl.
    images = (Image.fromarray(frame).quantize(64, dither=Image.Dither.NONE) for frame in frames)
    first = next(images)
    pause = max(20, round(1000.0 / fps))
    first.save(path, save_all=True, append_images=images, duration=pause, loop=0, optimize=False)


def _write_png(path: Path, frames: Iterator[Frame], fps: float) -> None:
    import matplotlib.image

    *_, last = frames
    matplotlib.image.imsave(path, last)
