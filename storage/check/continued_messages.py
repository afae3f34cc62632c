"""Messages that continue their streams, followed in the bytes of a chunk for a check of their numbers."""

from storage.log.message_form import MessageForm, MessageForms
from storage.log.sequence import LogPlace, SequenceCheck
from storage.segments.records import LogRecord


class ContinuedMessages:
    """Follows messages that continue their streams, for a `SequenceCheck`, which has what they reach after `settle`."""

    def __init__(self, check: SequenceCheck) -> None:
        self._check = check
        self._forms = MessageForms()

    def follow(self, topic: str, content: bytes, begin: int, end: int) -> int:
        """Samples of a message that continues its stream; 0 if it is to be read alone."""
        form = self._forms.by_topic.get(topic)
        return form.samples if form is not None and form.follow(content, begin, end) else 0

    def settle(self, topic: str) -> None:
        """Let the check have what the stream of a topic has reached, and expect nothing more of it."""
        form = self._forms.forget(topic)
        if form is not None and form.has_followed:
            self._settle(form)

    def settle_all(self) -> None:
        """The same of all streams, which are still expected to continue."""
        for topic, form in self._forms.by_topic.items():
            if form.has_followed:
                self._forms.succeeded(topic)
                self._settle(form)

    def _settle(self, form: MessageForm) -> None:
        self._check.skip_to(form.stream, form.next_seq, form.t0_ns + form.span_ns)
        form.settle()

    def drop_stale(self) -> None:
        """Expect nothing of streams of which the check has learnt otherwise what they have reached."""
        reached, forms = self._check.next_seq, self._forms.by_topic
        for topic in [each for each, form in forms.items() if reached.get(form.stream) != form.next_seq]:
            del forms[topic]

    def expect(self, record: LogRecord, place: LogPlace) -> None:
        """Expect messages like this one, which was read alone."""
        if self._check.next_seq[place.stream] == place.next_seq:
            self._forms.learn(record, place)
