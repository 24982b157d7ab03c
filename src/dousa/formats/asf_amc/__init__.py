"""Acclaim ASF and AMC: a skeleton of bones in one file, its motion in another."""

from __future__ import annotations

from dousa.formats.asf_amc.reading import read_amc

__all__ = ["read_amc"]
