"""Which worlds kernels go over, and how they are launched."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import warp as wp

wp.set_module_options({"enable_backward": False})


@wp.struct
class Rows:
    """A list of worlds on the device; what stands beyond the count is no row."""

    worlds: wp.array[int]  # (row,)
    count: wp.array[int]  # (1,)


@wp.func
def world_of(rows: Rows, i: int) -> int:
    """World of a row; -1 beyond the last one."""
    if i >= rows.count[0]:
        return -1
    return rows.worlds[i]


@wp.kernel
def _select(
    rows: Rows,
    mark: wp.array[int],  # (world,)
    wanted: int,
    needed: wp.array[int],  # (1,)
    room: int,
    # Out:
    selected: Rows,  # with count 0
):
    """List the worlds with the wanted mark, in the order of the rows: each counts those before it."""
    i = wp.tid()
    w = world_of(rows, i)
    if w < 0:
        return
    place = int(0)
    if needed[0] <= room:
        for k in range(i):
            if mark[rows.worlds[k]] == wanted:
                place += 1
        if mark[w] == wanted:
            selected.worlds[place] = w
            place += 1
    if i == rows.count[0] - 1:
        selected.count[0] = place


def stays_on_device(device: wp.Device) -> bool:
    """Whether the host is to launch without knowing how many rows there are: where it would have to wait for that."""
    return device.is_cuda


class RowList:
    """A list of up to ``room`` worlds in memory that stays where it is, so that launches over it can be recorded."""

    def __init__(self, room: int, device: wp.Device):
        self._memory = wp.zeros(1 + max(room, 1), dtype=int, device=device)
        self._host = self._memory.numpy()
        """On the CPU the list itself, elsewhere what was last assigned."""
        self._room = room
        self.stays_on_device = stays_on_device(device)
        self._launch = Launcher(device)
        self.device = Rows()
        """The list as kernels take it."""
        self.device.count, self.device.worlds = self._memory[:1], self._memory[1:]

    @property
    def count(self) -> int:
        """Number of rows, or what it can be at most where the host does not know."""
        return self._room if self.stays_on_device else int(self._host[0])

    @property
    def worlds(self) -> np.ndarray:
        """The worlds of a list that the host has assigned, shape ``(row,)``."""
        return self._host[1 : 1 + self._host[0]]

    def assign(self, worlds: np.ndarray) -> RowList:
        """Put these worlds on the list, and return it."""
        self._host[0] = len(worlds)
        self._host[1 : 1 + len(worlds)] = worlds
        if self._memory.device.is_cuda:
            self._memory.assign(self._host)
        return self

    def select(self, rows: RowList, mark: wp.array, wanted: int, needed: wp.array, room: int) -> None:
        """Put those of some worlds on the list that have the wanted mark, in their order.

        Args:
            rows: Worlds on another list.
            mark: Marks (world,).
            wanted: That of the worlds to select.
            needed: Space that something needs (1,); nothing is selected where it has not got it.
            room: Space that it has.
        """
        self.device.count.zero_()
        self._launch(_select, (rows,), [mark, wanted, needed, room, self.device])


class Launcher:
    """Launches kernels over rows; a kernel's first argument is the :class:`Rows`.

    Each kernel's launch is recorded once. Later only what has changed is set anew: packing all arguments takes five
    times as long as a launch of a small object's kernel.
    """

    def __init__(self, device: wp.Device):
        self._device = device
        self._recorded: dict[wp.Kernel, _Recorded] = {}

    def __call__(self, kernel: wp.Kernel, dim: tuple, arguments: Sequence) -> None:
        """Launch a kernel.

        Args:
            kernel: The kernel.
            dim: The list of rows, and the number of threads per row along each further axis.
            arguments: All but the first.
        """
        rows, *others = dim
        dim = (rows.count, *others)
        if 0 in dim:
            return
        recorded = self._recorded.get(kernel)
        if recorded is None:
            recorded = self._recorded[kernel] = _Recorded(kernel, dim, [rows.device, *arguments], self._device)
        else:
            recorded.update(dim, [rows.device, *arguments])
        recorded.command.launch()


class _Recorded:
    """The launch of a kernel as it was last."""

    def __init__(self, kernel: wp.Kernel, dim: tuple[int, ...], arguments: list, device: wp.Device):
        self._dim = dim
        self._arguments = arguments
        self.command = wp.launch(kernel, dim=dim, inputs=arguments, device=device, record_cmd=True)

    def update(self, dim: tuple[int, ...], arguments: list) -> None:
        """Set what is not the same object as before: a struct must not be changed in place once it is recorded."""
        if dim != self._dim:
            self.command.set_dim(dim)
            self._dim = dim
        for place, (old, new) in enumerate(zip(self._arguments, arguments, strict=True)):
            if old is not new:
                self.command.set_param_at_index(place, new)
        self._arguments = arguments
