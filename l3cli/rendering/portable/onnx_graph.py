"""Formulas on arrays, written as in numpy, that become a graph of standard ONNX operators.

Whole numbers are computed in float64, which holds them exactly up to 2⁵³, and index in int64. The package onnx is needed for
the last step alone, `model_bytes`.
"""

import dataclasses
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from l3cli.errors import RecipeError

OPSET, IR = 17, 8  # of the operators, and of the file
INSTALL = 'ONNX files need the package onnx; install it with: pip install "l3cli[onnx]"'
END = np.iinfo(np.int64).max


@dataclasses.dataclass(frozen=True)
class Tensor:
    """An array that a graph will compute."""

    graph: "Graph"
    name: str
    dtype: np.dtype

    def __add__(self, other: "Operand") -> "Tensor":
        return self._with("Add", other)

    def __radd__(self, other: "Operand") -> "Tensor":
        return self._with("Add", other)

    def __sub__(self, other: "Operand") -> "Tensor":
        return self._with("Sub", other)

    def __rsub__(self, other: "Operand") -> "Tensor":
        return self.graph.constant(other, self.dtype) - self

    def __mul__(self, other: "Operand") -> "Tensor":
        return self._with("Mul", other)

    def __rmul__(self, other: "Operand") -> "Tensor":
        return self._with("Mul", other)

    def __truediv__(self, other: "Operand") -> "Tensor":
        return self._with("Div", other)

    def __mod__(self, other: "Operand") -> "Tensor":
        """Of whole numbers, not negative where `other` is positive."""
        return self._with("Mod", other)

    def __gt__(self, other: "Operand") -> "Tensor":
        return self._with("Greater", other, bool)

    def __ge__(self, other: "Operand") -> "Tensor":
        return self._with("GreaterOrEqual", other, bool)

    def __lt__(self, other: "Operand") -> "Tensor":
        return self._with("Less", other, bool)

    def __and__(self, other: "Tensor") -> "Tensor":
        return self._with("And", other)

    def __or__(self, other: "Tensor") -> "Tensor":
        return self._with("Or", other)

    def equals(self, other: "Operand") -> "Tensor":
        return self._with("Equal", other, bool)

    def where(self, yes: "Tensor", no: "Operand") -> "Tensor":
        """`yes` where this is true, else `no`."""
        return self.graph.node("Where", (self, yes, self.graph.constant(no, yes.dtype)), yes.dtype)

    def least(self, other: "Operand") -> "Tensor":
        return self._with("Min", other)

    def most(self, other: "Operand") -> "Tensor":
        return self._with("Max", other)

    def within(self, least: "Operand", most: "Operand") -> "Tensor":
        return self.most(least).least(most)

    def size(self) -> "Tensor":
        return self.graph.node("Abs", (self,), self.dtype)

    def shifted(self, bits: int) -> "Tensor":
        """Whole numbers >> bits."""
        return (self * 2.0**-bits).floor()

    def floor(self) -> "Tensor":
        return self.graph.node("Floor", (self,), self.dtype)

    def to(self, dtype: DTypeLike) -> "Tensor":
        wanted = np.dtype(dtype)
        return self if wanted == self.dtype else self.graph.node("Cast", (self,), wanted, to=wanted)

    def take(self, index: "Operand", axis: int = 0) -> "Tensor":
        return self.graph.node("Gather", (self, self.graph.constant(index, np.int64)), self.dtype, axis=axis)

    def cut(self, axis: int, start: int, stop: int = END) -> "Tensor":
        """A stretch of an axis; `stop` from the end on if it is not positive, END: to the end."""
        bounds = [self.graph.constant([value], np.int64) for value in (start, stop, axis)]
        return self.graph.node("Slice", (self, *bounds), self.dtype)

    def shaped(self, shape: "Operand") -> "Tensor":
        return self.graph.node("Reshape", (self, self.graph.constant(shape, np.int64)), self.dtype)

    def sums(self, axis: int, exclusive: int) -> "Tensor":
        """Running sums along an axis."""
        return self.graph.node("CumSum", (self, self.graph.constant(axis, np.int64)), self.dtype, exclusive=exclusive)

    def total(self, axis: int) -> "Tensor":
        """Sums over an axis, which goes."""
        return self.graph.node("ReduceSum", (self, self.graph.constant([axis], np.int64)), self.dtype, keepdims=0)

    def lowest(self) -> "Tensor":
        """Index of the lowest along the first axis, the first of equals."""
        return self.graph.node("ArgMin", (self,), np.dtype(np.int64), axis=0, keepdims=0)

    def highest(self) -> "Tensor":
        return self.graph.node("ArgMax", (self,), np.dtype(np.int64), axis=0, keepdims=0)

    def _with(self, operator: str, other: "Operand", dtype: DTypeLike | None = None) -> "Tensor":
        inputs = (self, self.graph.constant(other, self.dtype))
        return self.graph.node(operator, inputs, self.dtype if dtype is None else np.dtype(dtype))


Operand = Tensor | ArrayLike


class Graph:
    """Nodes in the order in which they are made; equal constants and equal nodes are there once."""

    def __init__(self) -> None:
        self.nodes: list[tuple[str, tuple[str, ...], str, dict[str, Any]]] = []
        self.constants: dict[str, NDArray] = {}
        self._known: dict[Any, Tensor] = {}

    def input(self, name: str, dtype: DTypeLike) -> Tensor:
        return Tensor(self, name, np.dtype(dtype))

    def constant(self, values: Operand, dtype: DTypeLike = np.float64) -> Tensor:
        if isinstance(values, Tensor):
            return values
        array = np.asarray(values, dtype)
        key = (array.dtype.str, array.shape, array.tobytes())
        if key not in self._known:
            self._known[key] = Tensor(self, f"c{len(self.constants)}", array.dtype)
            self.constants[self._known[key].name] = array
        return self._known[key]

    def node(self, operator: str, inputs: tuple[Tensor, ...], dtype: np.dtype, **attributes: Any) -> Tensor:
        names = tuple(tensor.name for tensor in inputs)
        key = (operator, names, tuple(attributes.items()))
        if key not in self._known:
            self._known[key] = Tensor(self, f"t{len(self.nodes)}", dtype)
            self.nodes.append((operator, names, self._known[key].name, attributes))
        return self._known[key]

    def joined(self, parts: list[Tensor], axis: int = 0) -> Tensor:
        return self.node("Concat", tuple(parts), parts[0].dtype, axis=axis)

    def stacked(self, parts: list[Tensor]) -> Tensor:
        first = self.constant([0], np.int64)
        return self.joined([self.node("Unsqueeze", (part, first), part.dtype) for part in parts])

    def shape_of(self, tensor: Tensor) -> Tensor:
        return self.node("Shape", (tensor,), np.dtype(np.int64))

    def steps(self, start: Operand, stop: Operand) -> Tensor:
        """start, start + 1, …, stop − 1"""
        bounds = tuple(self.constant(value, np.int64) for value in (start, stop, 1))
        return self.node("Range", bounds, np.dtype(np.int64))


def model_bytes(
    graph: Graph,
    inputs: dict[str, tuple[Tensor, list[str | int]]],
    outputs: dict[str, tuple[Tensor, list[str | int]]],
    about: str,
) -> bytes:
    """An ONNX file of a graph: its inputs and outputs by name, each with the names or lengths of its axes; RecipeError if
    onnx is not installed."""
    try:
        from onnx import helper, numpy_helper
    except ImportError as error:
        raise RecipeError(INSTALL) from error

    def typed(dtype: np.dtype) -> int:
        return int(helper.np_dtype_to_tensor_dtype(dtype))

    def value(name: str, tensor: Tensor, axes: list[str | int]) -> Any:
        return helper.make_tensor_value_info(name, typed(tensor.dtype), axes)

    nodes = []
    for operator, names, made, attributes in graph.nodes:
        known = {key: typed(item) if isinstance(item, np.dtype) else item for key, item in attributes.items()}
        nodes.append(helper.make_node(operator, names, [made], **known))
    nodes += [helper.make_node("Identity", [tensor.name], [name]) for name, (tensor, _) in outputs.items()]
    made_of = helper.make_graph(
        nodes,
        "l3",
        [value(name, *each) for name, each in inputs.items()],
        [value(name, *each) for name, each in outputs.items()],
        [numpy_helper.from_array(array, name) for name, array in graph.constants.items()],
    )
    model = helper.make_model(made_of, opset_imports=[helper.make_opsetid("", OPSET)], ir_version=IR, doc_string=about)
    return bytes(model.SerializeToString(deterministic=True))
