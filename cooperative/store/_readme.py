"""What a campaign's folder says of itself, for whoever finds it in five years."""

from __future__ import annotations

import os
import platform
import textwrap
from datetime import date
from pathlib import Path

from cooperative.store._samples import package_versions
from cooperative.store._source import Source
from foundation.files import write_aside
from foundation.text import printable

NAME = "README.txt"

# Each file is told by what stands in it, so that the text stays true whichever of them there are.
TEXT = """\
{title}

This folder is a campaign of the Python package jaxmpm. A slope whose soil varies in space was simulated many
times, each time with other soil, to find out how likely it is to slide, in which way and how far.

A sample is one such slope: its number, and the coefficients of its random fields. A run is one simulation of a
sample by the material point method. Every sample runs on a rough grid (the screening), some run on a refined one
too (the audit). A slope that moved farther than the failure displacement failed. A run that broke off ended for
numerical reasons. All units are SI: metres, seconds, pascals.

Begun on {day} with
{versions}

GO ON

With jaxmpm installed, in this folder:

  jaxmpm status .     how far the campaign is, and what is known by now
  jaxmpm resume .     run what is missing; it may be stopped at any moment and goes on from there
  jaxmpm report .     write report.html, which opens in any browser
  jaxmpm export .     table.csv, campaign.h5 and series for ParaView

The same version gives the same numbers. A later one reads the folder too. Pin the versions above to repeat a run.

WHAT IS WHAT

  README.txt          this text, written once. It may be changed, and keeps what you add
  scene.toml          what was asked: ground, soil, random fields, grids, number of samples. Do not change it:
                      the samples would no longer belong to it
  campaign.json       what goes with it: defaults of the time when it began, points and heights of the files that the
                      scene names, a script's estimator in words; all of a campaign that was written in Python.
                      Do not change it either
  samples/rough/      one HDF5 file per finished sample on the rough grid
  samples/refined/    the same on the refined grid
  samples/slides/     refined runs that went on to the end of their slide, where they had stopped at failure
  samples/*.index     the numbers of files that were read and verified, with the size and times of each file, so that
                      only changed files are read again. They may be deleted: all files are then verified anew
  ground.h5           outline, toe and layers of the ground, and the particles of both grids at the start, by which the
                      samples are read and drawn. It may be deleted: it is then made again from scene.toml
  drawn.h5            the random soil of the samples in the report. It may be deleted, too
  initial/            the stress of each grid at rest, solved once. It may be deleted
  restart/            where long runs go on after an interruption. It may be deleted; these runs then start afresh
  measured.json       what was measured before the first run: terms of the random fields, which another machine might
                      count otherwise; factors of safety of both grids, and the failure displacement by the limit load,
                      where the scene asks for them. Earlier versions had field_modes.json, calibration.json and
                      limit_load.json in its place
  budget.json         refined runs allowed beyond the scene
  summary.json        the answer: probability of failure, its interval, modes, consequences
  report.html         the answer for people, with every figure
  figures/            the same figures, one by one
  maps/               how likely soil comes, how thick and fast, as `jaxmpm export` writes it, for GIS too
  series/             slides for ParaView, as `jaxmpm export` writes them
  table.csv           one line per sample and grid
  campaign.h5         every sample in one file
  campaign.nc         the same as netCDF, for xarray
  progress.log        when what was done, where that was no terminal
  *.damaged           a file that did not match its checksum. It was set aside and its sample run again
  .lock               held by the process that runs the campaign

Not every campaign has every file. To keep one, keep scene.toml, campaign.json, samples/, measured.json (or the three
files of earlier versions) and budget.json: the rest can be made again from these.

READ A SAMPLE WITHOUT JAXMPM

A sample's file is HDF5 behind 512 bytes of text with its checksum. Any HDF5 reader opens it, h5py for one:

  import h5py
  with h5py.File("samples/rough/000000.h5") as file:
      print(dict(file.attrs))            # status, steps, seconds, versions, dtype, device
      print(dict(file["row"].attrs))     # displacement, depth, runout (m), volume (m3, in a section m2), mode
      print(file["coefficients"][:])     # of its random fields
      print(list(file["fields"]))        # arrays over particles, where they were kept: displacement (axes, particles) m

The status is SETTLED (stands still), FINISHED (ran to the end of its time), DECIDED (passed the displacement at
which nobody wanted to know more), or the reason why the run broke off. A sample's number and coefficients give its
soil again: `jaxmpm export . --sample 7 --frames 21` runs number 7 once more and writes its moments for ParaView.
"""


def write_readme(folder: Path, source: Source) -> None:
    """Have a campaign's folder say what it is, where nothing of that name is there; OSError where the disk refuses."""
    if os.path.lexists(folder / NAME):
        return
    name = source.tables.get("campaign" if source.text is None else "name")
    name = name.get("name") if isinstance(name, dict) else name
    title = printable(name) if isinstance(name, str) and name.strip() else "a campaign"
    python = f"Python {platform.python_version()} on {platform.system()} {platform.machine()}"
    said = ", ".join([python, *(f"{name} {version}" for name, version in package_versions().items())])
    versions = textwrap.fill(said, 110, initial_indent="  ", subsequent_indent="  ")
    text = TEXT.format(title=title, day=date.today().isoformat(), versions=versions)
    write_aside(folder / NAME, text.encode())
