"""Search: the words by which people look for a kind of robot."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

__all__ = ["SYNONYMS", "matches", "search_text", "words_of"]

SYNONYMS: dict[str, str] = {
    # kinds, as backends declare them
    "rover": "ugv wheeled ground vehicle car mobile base amr agv",
    "car": "ugv wheeled ground vehicle rover",
    "copter": "drone uav uas multicopter multirotor quadcopter quadrotor hexacopter aircraft",
    "helicopter": "drone uav uas copter rotorcraft aircraft",
    "plane": "drone uav uas airplane aeroplane fixed-wing aircraft",
    "vtol": "drone uav uas plane copter quadplane aircraft",
    "airship": "drone uav uas blimp balloon aircraft",
    "boat": "ship vessel usv asv watercraft surface vehicle",
    "submarine": "sub rov auv uuv underwater vehicle",
    "arm": "manipulator robotic robot-arm cobot",
    "mobile_manipulator": "arm manipulator rover mobile base",
    "forklift": "agv amr fork lift truck pallet stacker",
    "gripper": "hand end effector end-effector fingers",
    "motor": "drive axis actuator servo joint",
    "differential_drive": "rover wheeled base motors drive",
    "humanoid": "biped legged",
    "quadruped": "dog legged",
    "camera": "vision image video",
    "antenna_tracker": "antenna tracker",
    # profiles, for robots whose backends declare no kind
    "mobile": "base vehicle",
    "aerial": "drone uav aircraft flying",
    "lidar": "laser scanner scan",
    "battery": "",
}
"""Further words for kinds and profiles."""
_SINGULAR = 4  # characters from which a plural is also tried without its s


def words_of(text: str) -> list[str]:
    """Return the words of a search."""
    return text.casefold().split()


def search_text(names: Iterable[str | None], terms: Sequence[str]) -> str:
    """Return the text in which words are looked for; `terms` are kinds and names of profiles."""
    known = (SYNONYMS.get(term, "") for term in terms)
    return " ".join(filter(None, (*names, *terms, *known))).casefold()


def matches(text: str, words: Iterable[str]) -> bool:
    """Return whether all words occur in a text, in the singular or the plural."""
    return all(
        word in text or (len(word) > _SINGULAR and word.removesuffix("s") in text) for word in words
    )
