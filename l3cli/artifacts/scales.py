"""Write HDF5 dimension scales, which name the axes of an artifact for xarray, netCDF tools and h5py.

In each group, every axis has one dimension scale with the name of the axis. The scale is one of:

1. the declared dataset with this name, if it contains the values along the axis (`wavelength`);
2. a copy of a declared dataset with a different name (`channels` for the axis `channel`);
3. a netCDF dimension without values, which only defines the length of the axis.

l3 itself ignores the scales when it reads artifacts.
"""

import functools
from collections.abc import Mapping
from typing import Any

import h5py
import numpy as np

from l3cli.artifacts.container import ENCODING, encoded
from l3cli.artifacts.schema import Group, Spec, declared, instances

# netCDF-4 requires this text in the NAME attribute of a dimension without values.
LENGTH_ALONE = "This is a netCDF dimension but not a netCDF variable.%10d"
REFERENCES = np.dtype([("dataset", h5py.ref_dtype), ("dimension", "<i4")])
Coordinates = Mapping[str, tuple[Any, Spec]]  # axis name → values along the axis and their declaration


def coordinates_of(content: Any) -> Coordinates:
    """Collect an instance's fields that contain axis coordinates, by axis name."""
    kind: type = type(content)
    fields = {name: spec for name, spec in _layout(kind)[0].items() if spec.coordinate}
    return {spec.axes[0]: (getattr(content, name), spec) for name, spec in fields.items()}


def name_axes(group: h5py.Group, kind: type, above: Coordinates, content: Any = None) -> None:
    """Write the dimension scales of a group and its subgroups.

    Parameters
    ----------
    group : h5py.Group
        A group with the fields of an instance of `kind`.
    kind : type
        The dataclass that declares the group.
    above : mapping
        Coordinates from the parent groups.
    content : dataclass, optional
        The instance that was written. Without it, only coordinates from the parent groups are used.
    """
    known = above if content is None else {**above, **coordinates_of(content)}
    _write_scales(group, kind, known)
    for name, below in _layout(kind)[1].items():
        held = (
            {place: None for place in [name] if place in group}
            if content is None
            else instances(name, getattr(content, name))
        )
        for place, each in held.items():
            name_axes(group[place], below.kind, known, each)


@functools.cache
def _layout(kind: type) -> tuple[dict[str, Spec], dict[str, Group]]:
    """Return the datasets with axes and the groups that a dataclass declares."""
    members = declared(kind)
    return (
        {name: member for name, member in members if isinstance(member, Spec) and member.axes},
        {name: member for name, member in members if not isinstance(member, Spec)},
    )


def _write_scales(group: h5py.Group, kind: type, known: Coordinates) -> None:
    """Write one dimension scale per axis of a group, and the references between scales and datasets.

    The references are written directly, because h5py's `attach_scale` would rewrite a scale's reference list for each
    dataset.
    """
    fields = {name: (spec, group[name]) for name, spec in _layout(kind)[0].items() if name in group}
    scales: dict[str, h5py.Dataset] = {}
    attached: dict[str, list[tuple[h5py.Reference, int]]] = {}
    for spec, dataset in fields.values():
        for axis, length in zip(spec.axes, dataset.shape, strict=True):
            if axis in fields and axis not in scales:
                scales[axis] = fields[axis][1]
                scales[axis].make_scale(axis)
            elif axis not in scales:
                scales[axis] = _new_scale(group, axis, length, known.get(axis))
    for name, (spec, dataset) in fields.items():
        if spec.axes != (name,):
            for index, axis in enumerate(spec.axes):
                attached.setdefault(axis, []).append((dataset.ref, index))
            lists = np.empty(len(spec.axes), object)
            lists[:] = [np.array([scales[axis].ref], h5py.ref_dtype) for axis in spec.axes]
            dataset.attrs.create("DIMENSION_LIST", lists, dtype=h5py.vlen_dtype(h5py.ref_dtype))
    for axis, references in attached.items():
        scales[axis].attrs.create("REFERENCE_LIST", np.array(references, REFERENCES), dtype=REFERENCES)


def _new_scale(group: h5py.Group, axis: str, length: int, known: tuple[Any, Spec] | None) -> h5py.Dataset:
    """Create a dimension scale for an axis without a declared dataset of the same name.

    The scale contains the coordinates in `known` if there are `length` of them. Otherwise it has no values.
    """
    if known is None or len(known[0]) != length or not length:
        scale = group.create_dataset(axis, (length,), ">f4", track_times=False)
        scale.make_scale(LENGTH_ALONE % length)
        return scale
    values, spec = known
    is_text = spec.dtype == "str"
    values = encoded(values) if is_text else np.asarray(values, spec.dtype)
    scale = group.create_dataset(axis, data=values, track_times=False)
    scale.make_scale(axis)
    scale.attrs["_Encoding" if is_text else "units"] = ENCODING if is_text else spec.unit
    return scale
