"""Plays an episode that failed once more, and keeps what shows why: its journal, and a film of a camera."""

import io
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

from emulator.evaluation.episodes import Episode, Setting, play_one, policy_of
from emulator.learning import RobotEnv
from emulator.physics.cameras import CameraError
from urproto.durable import write_file

_QUALITY: Final = 60
_CAMERA: Final = "overview"


def keep_failure(setting: Setting, episode: Episode, folder: Path) -> list[Path]:
    """Write ``SEED.journal`` and, if the scene has a camera ``overview`` and pictures can be rendered, ``SEED.webp``.

    Returns the files; none if the episode went otherwise this time. Raises EvaluationError.
    """
    env = setting.environment(recorded=True, checked=True)
    pictures: list[Any] = []
    try:
        policy = policy_of(setting, env)
        if play_one(env, policy, setting.length(env), episode.seed, lambda: _film(env, pictures)) != episode:
            return []
        files = {"journal": env.robot.journal}
        if pictures:
            files["webp"] = _webp(pictures, env.step_s)
    finally:
        env.close()
    folder.mkdir(exist_ok=True)
    paths = []
    for suffix, content in files.items():
        paths.append(folder / f"{episode.seed}.{suffix}")
        write_file(paths[-1], content)
    return paths


def _film(env: RobotEnv[Any, Any], pictures: list[Any]) -> None:
    if _CAMERA not in env.scene.cameras:
        return
    try:
        pictures.append(env.picture(_CAMERA))
    except CameraError:  # no renderer on this machine: the journal shows more anyway
        return


def _webp(pictures: Sequence[Any], step_s: float) -> bytes:
    from PIL import Image

    first, *others = (Image.fromarray(picture) for picture in pictures)
    film = io.BytesIO()
    first.save(
        film, "webp", save_all=True, append_images=others, duration=round(1000 * step_s), loop=0, quality=_QUALITY
    )
    return film.getvalue()
