"""The thread that gives a target its messages, each once, until it takes them."""

import threading
import time
from collections.abc import Callable, Collection

from analytics.alerts.book import CLEARED, ENDED, LONGEST_WAIT_S, AlertBook, Parcel
from analytics.alerts.kept_alerts import Alert
from analytics.alerts.patience import Patience
from analytics.alerts.rules import ALARM, QuietHours
from analytics.alerts.targets import Message, NotSent, Target
from stream.closing import Closing
from stream.errors import GyrofleetError, StoreError

_LOOK_S = 0.5
_SINGLY = 3  # more than this at once come together, where the target can
_LONGEST_SEND_S = 60.0
_END_S = 5.0
_FIRST_WAIT_S = 5.0


class TargetSender(Closing):
    """Sends the messages of a book to one target, in a thread of its own.

    While a target takes nothing it is tried after 5 s, 10 s, and so on up to 10 min. `trouble` says since when and why
    it takes nothing, if so; `report` is called when that begins and ends. `now_ns` is a clock that nobody sets; a
    message may take `longest_send_s` in all. The first wait is `first_wait_s`.
    """

    def __init__(
        self, name: str, target: Target, quiet: QuietHours | None, book: AlertBook, store: str,
        report: Callable[[str], None], now_ns: Callable[[], int], longest_send_s: float = _LONGEST_SEND_S,
        first_wait_s: float = _FIRST_WAIT_S,
    ) -> None:  # fmt: skip
        self._name, self._target, self._quiet, self._book, self._store = name, target, quiet, book, store
        self._report, self._now_ns, self._longest_send_s = report, now_ns, longest_send_s
        self._first_wait_s = first_wait_s
        self.trouble = ""
        self._failures = 0
        self._patience: Patience | None = None
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._loop, name=f"alerts to {name}", daemon=True)
        self._thread.start()

    @property
    def is_alive(self) -> bool:
        """Whether it is at work; it ends by an error of the program only."""
        return self._thread.is_alive()

    def close(self) -> None:
        """End; a message that the target does not answer within some seconds is sent again after the next start."""
        self._closing.set()
        self._thread.join(_END_S)
        if self._patience is not None:
            self._patience.cut()
        self._thread.join()

    def _loop(self) -> None:
        wait_s = _LOOK_S
        while not self._closing.wait(wait_s):
            wait_s = _LOOK_S
            for parcel in self._parcels():
                if self._closing.is_set():
                    return
                if not self._is_sent(parcel):
                    wait_s = min(self._first_wait_s * 2.0 ** min(self._failures - 1, 10), LONGEST_WAIT_S)
                    break  # the others wait as well

    def _parcels(self) -> list[Parcel]:
        """What is due: what was tried together before, then the rest, together if it is much."""
        due = self._book.due(self._name, self._now_ns(), self._is_held)
        before: dict[str, Parcel] = {}
        for alert, delivery in due:
            if delivery.mail:
                before.setdefault(delivery.mail, []).append((alert, delivery))
        fresh = [each for each in due if not each[1].mail]
        most = self._target.most_at_once
        if most == 1 or len(fresh) <= _SINGLY:
            return [*before.values(), *([each] for each in fresh)]
        return [*before.values(), *(fresh[begin : begin + most] for begin in range(0, len(fresh), most))]

    def _is_held(self, alert: Alert) -> bool:
        """Whether it waits for the end of the quiet hours."""
        if self._quiet is None or (alert.severity == ALARM and not self._quiet.holds_alarms):
            return False
        return self._quiet.covers(time.time_ns())

    def _is_sent(self, parcel: Parcel) -> bool:
        """Send messages; whether the target has taken them."""
        messages = [self._message(alert, delivery.event) for alert, delivery in parcel]
        try:
            identity = ""
            if len(parcel) > 1:
                identity = parcel[0][1].mail or self._book.wrap(parcel)
            with Patience(self._longest_send_s) as self._patience:
                self._target.send(messages, identity, self._patience, parcel[0][1].taken)
        except GyrofleetError as error:
            self._failed(parcel, str(error), error.taken if isinstance(error, NotSent) else ())
            return False
        finally:
            self._patience = None
        if self.trouble:
            self._report(f"target {self._name} takes alerts again")
        self._failures, self.trouble = 0, ""
        self._kept(lambda: self._book.sent(parcel, time.time_ns()))
        return True

    def _failed(self, parcel: Parcel, why: str, taken: Collection[str]) -> None:
        if self._closing.is_set() and not taken:
            return
        self._failures += 1
        if not self.trouble:
            named = f"alert {parcel[0][0].id}" if len(parcel) == 1 else f"{len(parcel)} alerts"
            self._report(f"target {self._name} does not take {named}: {why}; it is tried until it does")
        self.trouble = f"target {self._name} has taken nothing in {self._failures} tries: {why}"
        self._kept(lambda: self._book.not_sent(parcel, why, taken, self._now_ns(), self._first_wait_s))

    def _kept(self, note: Callable[[], None]) -> None:
        try:
            note()
        except StoreError as error:  # the book has it in memory, and tries again
            self._report(f"warning: {error}; after a restart a message may come again")

    def _message(self, alert: Alert, event: str) -> Message:
        over, over_zh = ("over: ", "已结束：") if event == CLEARED else ("", "")
        if event == ENDED:
            over, over_zh = f"{alert.ending}: ", f"{alert.ending_zh}："
        return Message(
            id=alert.id, event=event, rule=alert.rule, severity=alert.severity, subject=alert.subject,
            text=over + alert.text, text_zh=over_zh + alert.text_zh, raised_ns=alert.raised_ns or 0, store=self._store,
        )  # fmt: skip
