"""From keys to poses, as in MMD: turns and moves of bones, shares of other bones, then IK of the legs.

MMD solves IK by cyclic coordinate descent from the pose of the keys; some rounds of it choose the direction of the
knee. The rest is solved exactly: the knee, a hinge about x, bends until the ankle is as far from the hip as its goal,
and the thigh turns the shortest way towards it. So does the foot by the toes' IK. Chains of other lengths (hair, ties)
are ignored.
"""

from __future__ import annotations

import numpy as np

from dousa.arrays import BoolArray, FloatArray
from dousa.formats.mmd.models import Bone, Model
from dousa.formats.mmd.vmd import VmdFile
from dousa.motion.rotations import between, conjugate, from_axis_angle, identity, multiply, rotate, slerp

_LEAST_BEND = np.deg2rad(0.5)  # of a knee: the limit in the definition of the usual models


class Poses:
    """The bones of a model in all frames of a motion.

    Parameters
    ----------
    model : its bones.
    motion : the keys.
    needed : numbers of bones, with all that they depend on: see `find_needed`.

    Attributes
    ----------
    turns, places : by bone, (T, 4) and (T, 3) in the world.
    """

    def __init__(self, model: Model, motion: VmdFile, needed: set[int]) -> None:
        self.model, self.motion = model, motion
        self._order = [number for number in model.order if number in needed]
        self._local: dict[int, FloatArray] = {}
        self._moved: dict[int, FloatArray] = {}
        self.turns: dict[int, FloatArray] = {}
        self.places: dict[int, FloatArray] = {}
        for number in self._order:
            self._set_local(number)
        self._place(set(self._order))
        chains = [number for number in self._order if model.bones[number].ik is not None]
        # A foot's goal before that of its toes, which hangs on it.
        for number in sorted(chains, key=lambda n: -len(_ik_links(model.bones[n]))):
            self._solve(number)

    def _set_local(self, number: int) -> None:
        bone, count = self.model.bones[number], self.motion.n_frames
        keys = self.motion.bones.get(bone.name)
        moves, turns = keys.sample(count) if keys else (np.zeros((count, 3)), identity((count,)))
        if bone.source >= 0 and bone.turns:
            taken = self._local[bone.source]
            share = abs(bone.share)
            part = taken if share == 1 else slerp(identity((count,)), taken, share)
            turns = multiply(turns, conjugate(part) if bone.share < 0 else part)
        if bone.source >= 0 and bone.moves:
            moves = moves + bone.share * self._moved[bone.source]
        self._local[number], self._moved[number] = turns, moves

    def _place(self, members: set[int]) -> None:
        for number in self._order:
            if number in members:
                bone = self.model.bones[number]
                turns, places = self._local[number], bone.place + self._moved[number]
                if bone.parent >= 0:
                    above = self.turns[bone.parent]
                    places = places - self.model.bones[bone.parent].place
                    places = self.places[bone.parent] + rotate(above, places)
                    turns = multiply(above, turns)
                self.turns[number], self.places[number] = turns, places

    def _below(self, number: int) -> set[int]:
        members = {number}
        for other in self._order:
            if self.model.bones[other].parent in members:
                members.add(other)
        return members

    def _solve(self, number: int) -> None:
        bones = self.model.bones
        chain = bones[number].ik
        if chain is None or not {chain.target, *chain.links} <= set(self._order):
            return
        on = self._switched_on(number)
        if not on.any():
            return
        if len(chain.links) == 2 and chain.links[1] != chain.links[0]:
            self._solve_leg(chain.target, *chain.links, self.places[number], on)
        elif len(chain.links) == 1:
            (link,) = chain.links
            wanted = self.places[number] - self.places[link]
            self._aim(link, self.places[chain.target] - self.places[link], wanted, on)

    def _switched_on(self, number: int) -> BoolArray:
        """Frames in which an IK counts: unless switched off, or only the links have keys."""
        name, keys = self.model.bones[number].name, self.motion.bones
        on: BoolArray = np.ones(self.motion.n_frames, bool)
        for frame, states in self.motion.switches:
            if name in states:
                on[frame:] = states[name]
        links = [self.model.bones[link].name for link in _ik_links(self.model.bones[number])]
        if name not in keys and any(link in keys for link in links):
            on[:] = False
        return on

    def _solve_leg(self, ankle: int, knee: int, hip: int, goal: FloatArray, on: BoolArray) -> None:
        bones = self.model.bones
        thigh, shank = bones[knee].place - bones[hip].place, bones[ankle].place - bones[knee].place
        wanted = goal - self.places[hip]
        self._orient(hip, _descend(self.turns[hip], thigh, shank, wanted), on)
        # |thigh + R_x(bend) shank| = |wanted|
        along = thigh[1:] @ shank[1:]
        across = thigh[2] * shank[1] - thigh[1] * shank[2]
        size = max(float(np.hypot(along, across)), 1e-12)
        needed = ((wanted**2).sum(axis=1) - thigh @ thigh - shank @ shank) / 2 - thigh[0] * shank[0]
        bend = np.arctan2(across, along) + np.arccos(np.clip(needed / size, -1.0, 1.0))
        bend = np.clip(bend, _LEAST_BEND, np.pi)
        turns = from_axis_angle(np.stack((bend, 0 * bend, 0 * bend), axis=1))
        self._local[knee] = np.where(on[:, None], turns, self._local[knee])
        self._place(self._below(knee))
        self._aim(hip, self.places[ankle] - self.places[hip], wanted, on)

    def _aim(self, link: int, now: FloatArray, wanted: FloatArray, on: BoolArray) -> None:
        """Turn a bone by the shortest way that takes one direction (T, 3) in the world to another."""
        size = np.linalg.norm(now, axis=1) * np.linalg.norm(wanted, axis=1)
        fits = on & (size > 1e-9)
        safe = np.where(fits[:, None], now, (0.0, 1.0, 0.0)), np.where(fits[:, None], wanted, (0.0, 1.0, 0.0))
        world = multiply(between(*safe), self.turns[link])
        self._orient(link, world, fits)

    def _orient(self, link: int, world: FloatArray, where: BoolArray) -> None:
        """Set the orientation (T, 4) of a bone in the world, in some of the frames."""
        parent = self.model.bones[link].parent
        turns = multiply(conjugate(self.turns[parent]), world) if parent >= 0 else world
        self._local[link] = np.where(where[:, None], turns, self._local[link])
        self._place(self._below(link))


def _descend(
    leg: FloatArray, thigh: FloatArray, shank: FloatArray, wanted: FloatArray, rounds: int = 12, most_step: float = 2.0
) -> FloatArray:
    """Orientation (T, 4) of the thigh after some rounds: the knee turns towards the goal, then the thigh.

    Parameters
    ----------
    leg : (T, 4) orientation of the thigh in the world by its keys.
    thigh, shank : (3,) from hip to knee, from knee to ankle, at rest.
    wanted : (T, 3) from hip to goal in the world.
    rounds : of the descent.
    most_step : rad, of a knee in a round.
    """
    bend = np.full(len(leg), _LEAST_BEND)
    for _ in range(rounds):
        goal = rotate(conjugate(leg), wanted)
        y, z = (goal - thigh).T[1:]
        shank_y, shank_z = _bend(shank, bend).T[1:]
        step = np.arctan2(shank_y * z - shank_z * y, shank_y * y + shank_z * z)
        bend = np.clip(bend + np.clip(step, -most_step, most_step), _LEAST_BEND, np.pi)
        leg = multiply(leg, between(thigh + _bend(shank, bend), goal))
    return leg


def _bend(vector: FloatArray, angles: FloatArray) -> FloatArray:
    """(T, 3) a vector turned about x."""
    x, y, z = vector
    cosine, sine = np.cos(angles), np.sin(angles)
    return np.stack((np.full(len(angles), x), y * cosine - z * sine, y * sine + z * cosine), axis=1)


def _ik_links(bone: Bone) -> tuple[int, ...]:
    return bone.ik.links if bone.ik else ()


def find_needed(model: Model, wanted: list[int]) -> set[int]:
    """Find some bones and all that they depend on: parents, sources, and IK bones that move them."""
    pulls = [(n, b.ik) for n, b in enumerate(model.bones) if b.ik is not None and len(b.ik.links) in (1, 2)]
    closed: set[int] = set()
    waiting = list(wanted)
    while waiting:
        number = waiting.pop()
        if number < 0 or number in closed:
            continue
        closed.add(number)
        waiting += [model.bones[number].parent, model.bones[number].source]
        waiting += [n for puller, ik in pulls if number in ik.links for n in (puller, ik.target)]
    return closed
