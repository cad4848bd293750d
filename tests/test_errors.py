"""Messages are one line, and errors come home whole from another process."""

import pickle

from gendom.errors import GendomError, RecordingError, SimulationError


def test_message_parts():
    assert str(GendomError("is odd")) == "is odd"
    assert str(GendomError("is odd", where="a.json", fix="mend it")) == "a.json: is odd; mend it"
    error = GendomError("is cut short", where="a\nb\x1b[31m.ply", fix="copy it")
    assert str(error) == r"a\nb\u001b[31m.ply: is cut short; copy it"
    assert len(str(GendomError("x" * 10**6))) < 5000
    # errors survive pickling
    simulation = SimulationError("x", fix="y", world=1, time=0.5, parameters={"E": 1.0}, particle=7)
    recording = RecordingError(where="a.npz", faults=["one", "two"])
    for error in (simulation, recording):
        again = pickle.loads(pickle.dumps(error))
        assert type(again) is type(error)
        assert str(again) == str(error)
        assert again.__dict__ == error.__dict__
    assert str(recording) == "a.npz: one\na.npz: two"
