"""Progress bars: what they say, how wide they are, and where they stay away."""

import io
import pty
import re
import termios
from contextlib import contextmanager, redirect_stderr

from gendom import progress
from gendom.progress import bar, each, silence


@contextmanager
def terminal():
    """Stderr is a terminal of 80 columns; the list holds what stood there, once it is left."""
    lines = []
    master, slave = pty.openpty()
    termios.tcsetwinsize(slave, (25, 80))
    with open(master, "rb", buffering=0) as screen, open(slave, "w") as file:
        try:
            with redirect_stderr(file):
                yield lines
        finally:
            file.write("\nend")
            file.flush()
            written = b""
            while not written.endswith(b"end"):
                written += screen.read(4096)
            lines += [s for s in re.split("[\r\n]", written.decode()[:-3]) if s.strip()]


def test_iterations_are_counted_and_the_last_line_is_full():
    with terminal() as lines:
        assert list(each("abc", "acting", "action")) == ["a", "b", "c"]
    assert "acting: 100%|" in lines[-1] and "action 3/3" in lines[-1]
    with terminal() as lines, bar("estimating", 1, "iteration") as show:
        for n in range(5):
            show(n, 12, "E/rho 1.23e+05 m^2/s^2, 12.3 mm off")
    assert " 0%|" in lines[0]
    assert re.match(r"estimating: 100%\|[█#]+\| iteration 4/4, 00:00, E/rho.*mm off$", lines[-1])
    assert all(len(line) <= 80 for line in lines)


def test_nothing_shows_where_it_is_not_wanted():
    with terminal() as lines:
        with silence(), bar("acting", 4, "action") as show:
            show(2)
        list(each("abc", "acting", "action", shown=False))
    assert not progress._silent and lines == []
    with redirect_stderr(io.StringIO()) as file, bar("acting", 4, "action") as show:
        show(2)
    assert file.getvalue() == ""
