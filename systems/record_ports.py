"""Where records become vectors, and vectors records: `RecordReader` and `RecordSender`."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from pydrake.common.value import AbstractValue
from pydrake.systems.framework import BasicVector, Context, LeafSystem

from gridpush_drake.multibody.weak_calc import NO_SLOTS, weakly


class RecordReader(LeafSystem):
    """Gives what a record says as vectors.

    .. pydrake_system::

        name: RecordReader
        input_ports:
        - record
        output_ports:
        - position_measured
        - ...

    * record: abstract record of this package, such as an `ArmStatus`. It need not be connected; the
      record that the system was made with then stands for it.
    * position_measured and so on: vectors of what is read from the record, by the names that the
      system was made with.
    """

    __slots__ = NO_SLOTS

    def __init__(self, first: Any, outputs: Mapping[str, Callable[[Any], ArrayLike]]) -> None:
        """Declares the ports.

        Args:
            first: stands for the record until one is there.
            outputs: functions that read a vector from a record, by the ports' names.
        """
        super().__init__()
        self._first = first
        self._record = self.DeclareAbstractInputPort("record", AbstractValue.Make(first))
        for name, read in outputs.items():
            size = np.size(read(first))
            self.DeclareVectorOutputPort(
                name, size, weakly(self._calc, read), {self._record.ticket()}
            )

    def _calc(
        self, context: Context, output: BasicVector, read: Callable[[Any], ArrayLike]
    ) -> None:
        has_record = self._record.HasValue(context)
        record = self._record.Eval(context) if has_record else self._first
        output.SetFromVector(np.asarray(read(record), dtype=np.float64).ravel())


class RecordSender(LeafSystem):
    """Sends a record of what is on its ports, at even times.

    .. pydrake_system::

        name: RecordSender
        input_ports:
        - position_measured
        - ...

    * position_measured and so on: vectors that the record is made of, by the names that the system
      was made with.
    """

    __slots__ = NO_SLOTS

    def __init__(
        self,
        make: Callable[..., Any],
        inputs: Mapping[str, int],
        send: Callable[[Any], None],
        *,
        period: float,
        offset: float = 0.0,
    ) -> None:
        """Declares the ports.

        Args:
            make: makes a record of the time, s, and of the vectors on the ports in their order.
            inputs: sizes of the vectors, by the ports' names.
            send: takes the record.
            period: time between two records, s.
            offset: time of the first record, s.
        """
        super().__init__()
        self._make = make
        self._send = send
        self._vectors = [self.DeclareVectorInputPort(name, size) for name, size in inputs.items()]
        self.DeclarePeriodicPublishEvent(period, offset, self._publish)

    def _publish(self, context: Context) -> None:
        vectors = [np.array(port.Eval(context)) for port in self._vectors]
        self._send(self._make(context.get_time(), *vectors))
