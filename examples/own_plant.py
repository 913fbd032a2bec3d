"""A plant of your own: a machine in another process, spoken to over a local socket.

    micah-plan solve problems/drawer_open.yaml -o plan.json
    micah-plan execute plan.json --plant examples/own_plant.py:ProcessPlant --trials 5 -o runs.csv

`ProcessPlant` is the side of micah_plan: it asks, waits with a timeout, asks again, and stops with one sentence if the
machine stays silent or dies. `serve` is the side of the machine, here a simulated one; put your driver in its place.
The guide "Your own machine" leads from here to a robot with ROS 2.

The protocol: one JSON object per line. Every request has a number `seq`, and its reply bears the same. A request that
comes twice is carried out once and answered twice, so asking again is always safe; a reply to an earlier request came
late and is thrown away. Whoever sees the line closed stops: a client that dies takes the machine's process with it.
"""

from __future__ import annotations

import argparse
import json
import os
import secrets
import signal
import socket
import subprocess
import sys
import time
from contextlib import suppress
from typing import Any

import numpy as np

from micah_plan.documents.model import model_text, usable_model
from micah_plan.execution.nominal import NominalPlant
from micah_plan.execution.plant import Command, Measurement, PlantError
from micah_plan.task.problem import Problem
from micah_plan.task.start import Start

HOST = "127.0.0.1"
START_TIMEOUT_S = 60.0
END_TIMEOUT_S = 5.0
LONGEST_LINE = 1_000_000
FAULTS = ("drop", "late", "mute", "die", "stop")


class ProcessPlant:
    """A plant that lives in a process of its own. It says no truth, so executions end as the belief says."""

    def __init__(self, problem: Problem, *, timeout_s: float = 2.0, attempts: int = 3, fault: str = "") -> None:
        """Start the machine's process.

        Args:
            timeout_s: how long a reply may take before the request is sent again [s].
            attempts: how often a request is sent.
            fault: `KIND:SEQ`, what shall go wrong with which request, see `Faults`; empty: nothing.

        Raises:
            PlantError: if the process does not start.
        """
        self._timeout, self._attempts = timeout_s, attempts
        self._seq, self._unread, self._failure = 0, b"", ""
        self._socket: socket.socket | None = None
        token = secrets.token_hex(16)  # so that no other process on this computer can answer for the machine
        with socket.create_server((HOST, 0)) as listener:
            arguments = [sys.executable, os.path.abspath(__file__), *(["--fault", fault] if fault else [])]
            self._process = subprocess.Popen(arguments, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True)
            setup = {
                "port": listener.getsockname()[1],
                "token": token,
                "model": model_text(problem.automaton),
                "start": [list(problem.start.mean), list(problem.start.std), problem.start.mode],
                "control_period": problem.plant.get("control_period", 0.5),
            }
            with suppress(BrokenPipeError), self._process.stdin:  # type: ignore[union-attr]
                print(json.dumps(setup), file=self._process.stdin)
            self._connect(listener, token)

    def reset(self, rng: np.random.Generator) -> Measurement:
        """Ask for a new trial; the machine's noise follows a seed that is drawn here."""
        return self._asked({"do": "reset", "seed": int(rng.integers(2**53))})

    def apply(self, command: Command) -> Measurement:
        """Ask for one control step, and wait until it has ended."""
        posture = None if command.posture is None else command.posture.tolist()
        told = {"input": command.input.tolist(), "origin": command.origin.tolist(), "handle": command.handle.tolist()}
        return self._asked({"do": "apply", "command": {**told, "posture": posture}})

    def close(self) -> None:
        """End the machine's process: it ends by itself when the line is closed, and is killed if it does not."""
        self._hang_up()
        try:
            self._process.wait(END_TIMEOUT_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()

    @property
    def pid(self) -> int:
        """Of the machine's process."""
        return self._process.pid

    def _connect(self, listener: socket.socket, token: str) -> None:
        """Wait until the process calls and says the token; turn everybody else away."""
        listener.settimeout(0.2)
        until = time.monotonic() + START_TIMEOUT_S
        while self._process.poll() is None and time.monotonic() < until:
            with suppress(OSError):
                self._socket, _ = listener.accept()
                if self._line(time.monotonic() + 1.0) == token.encode():
                    return
            self._hang_up()
        code = self._process.poll()
        raise self._failed(f"did not call within {START_TIMEOUT_S:g} s" if code is None else _ended(code))

    def _asked(self, request: dict[str, Any]) -> Measurement:
        """The machine's reply to a request, which is sent again while there is none."""
        if self._failure:
            raise PlantError(self._failure)
        self._seq += 1
        line = json.dumps({"seq": self._seq, **request}).encode() + b"\n"
        try:
            for _ in range(self._attempts):
                self._send(line)
                with suppress(TimeoutError):
                    return self._reply(time.monotonic() + self._timeout)
        except OSError:  # the line is closed
            raise self._failed(self._ending()) from None
        raise self._failed(f"did not answer a request that was sent {self._attempts} times")

    def _send(self, line: bytes) -> None:
        if self._socket is None:
            raise ConnectionError
        self._socket.settimeout(END_TIMEOUT_S)
        self._socket.sendall(line)

    def _reply(self, until: float) -> Measurement:
        """The measurement of the present request, up to a time; replies to earlier ones are thrown away."""
        while True:
            line = self._line(until)
            try:
                reply = json.loads(line)
                if reply["seq"] < self._seq:
                    continue
                if "failure" in reply:
                    raise PlantError(str(reply["failure"]))
                seen = reply["measurement"]
                return Measurement(float(seen["time"]), np.array(seen["position"]), np.array(seen["quaternion"]))
            except (ValueError, KeyError, TypeError):
                raise self._failed(f"sent {line[:60]!r}, which is no reply") from None

    def _line(self, until: float) -> bytes:
        """The next line, without its end.

        Raises:
            TimeoutError: if there is none up to that time.
            OSError: if there will be none.
        """
        while b"\n" not in self._unread:
            left = until - time.monotonic()
            if left <= 0 or self._socket is None:
                raise TimeoutError
            self._socket.settimeout(left)
            more = self._socket.recv(65536)
            if not more or len(self._unread) > LONGEST_LINE:
                raise ConnectionError
            self._unread += more
        line, _, self._unread = self._unread.partition(b"\n")
        return line

    def _failed(self, how: str) -> PlantError:
        """The error of a machine that cannot be used any more; its process is ended."""
        self._failure = f"the machine's process {how}"
        self._process.kill()
        self.close()
        return PlantError(self._failure)

    def _ending(self) -> str:
        """How a process ended that closed the line."""
        with suppress(subprocess.TimeoutExpired):
            return _ended(self._process.wait(END_TIMEOUT_S))
        return "hung up"

    def _hang_up(self) -> None:
        if self._socket is not None:
            self._socket.close()
        self._socket, self._unread = None, b""


def _ended(code: int) -> str:
    return f"was killed by signal {-code}" if code < 0 else f"ended with exit code {code}"


class Machine:
    """What a driver has to do: carry out requests, each once, and say what was measured. This one is simulated."""

    def __init__(self, setup: dict[str, Any]) -> None:
        mean, std, mode = setup["start"]
        automaton = usable_model(setup["model"].encode(), "the model that was sent")
        self._plant = NominalPlant(automaton, Start(tuple(mean), tuple(std), mode), setup["control_period"])

    def carry_out(self, request: dict[str, Any]) -> dict[str, Any]:
        """The measurement after a request, as plain data."""
        if request["do"] == "reset":
            seen = self._plant.reset(np.random.default_rng(request["seed"]))
        else:
            told = request["command"]
            posture = None if told["posture"] is None else np.array(told["posture"])
            displacements = (np.array(told[name]) for name in ("input", "origin", "handle"))
            seen = self._plant.apply(Command(*displacements, posture))
        return {"time": seen.time, "position": seen.position.tolist(), "quaternion": seen.quaternion.tolist()}


def serve(fault: str) -> None:
    """The process of the machine: reads on stdin whom to call, and answers until the line is closed."""
    setup = json.loads(sys.stdin.readline())
    machine, faults, last, reply = Machine(setup), Faults(fault), 0, ""
    with socket.create_connection((HOST, setup["port"])) as line, line.makefile("rw", encoding="utf-8") as lines:
        print(setup["token"], file=lines, flush=True)
        for text in lines:
            request = json.loads(text)
            is_new = request["seq"] > last
            if is_new:
                last = request["seq"]
                reply = json.dumps({"seq": last, "measurement": machine.carry_out(request)})
            if request["seq"] == last:  # the same request once more is answered again, and not carried out again
                for answer in faults.replies(last, reply, is_new):
                    print(answer, file=lines, flush=True)


class Faults:
    """What goes wrong on purpose, so that every way to fail can be tried."""

    def __init__(self, fault: str) -> None:
        """Args: fault: `KIND:SEQ`; empty: nothing goes wrong.

        ``drop:SEQ`` loses the reply to that request once; ``late:SEQ`` sends it late, and once more when nobody waits
        for it; ``mute:SEQ`` is silent from there on; ``die:SEQ`` kills the process; ``stop:SEQ`` reports that the
        machine stopped.
        """
        self._kind, _, number = fault.partition(":")
        self._seq = int(number or 0)
        self._withheld: list[str] = []

    def replies(self, seq: int, reply: str, is_new: bool) -> list[str]:
        """The lines that are really sent; `is_new`: the request comes for the first time."""
        if self._kind == "mute" and seq >= self._seq:
            return []
        sent, self._withheld = [*self._withheld, reply], []
        if seq != self._seq or not is_new:
            return sent
        if self._kind == "die":
            os.kill(os.getpid(), signal.SIGKILL)
        if self._kind == "late":
            self._withheld = [reply]
        return [json.dumps({"seq": seq, "failure": "the protective stop was pressed"})] if self._kind == "stop" else []


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="The machine's process; `ProcessPlant` starts it.")
    parser.add_argument("--fault", default="", help=f"KIND:SEQ, with KIND one of {', '.join(FAULTS)}")
    with suppress(ConnectionError, KeyboardInterrupt):  # whoever called has gone
        serve(parser.parse_args().fault)
