"""A method's answer to a problem, and its processor time."""

from __future__ import annotations

import time

from cellapp.commands.trials.benchmark.methods.registry import METHODS
from cellapp.commands.trials.benchmark.problem import Answer, NotTaken, Problem
from cellapp.ground.errors import InputError
from cellapp.ground.threads import one_blas_thread


def answer_of(method: str, problem: Problem) -> tuple[Answer | None, float]:
    """Let a method answer; return the answer, None if it does not accept the problem, and its processor time [s].

    Raises
    ------
    InputError
        If the method does not predict a point for each held-out stop.
    """
    of_problem, answer = METHODS[method], None
    began_s = time.process_time()
    try:
        with one_blas_thread():
            answer = of_problem(problem)
    except NotTaken:
        pass
    seconds, expected = time.process_time() - began_s, problem.held_out.p_M.shape
    if answer is not None and answer.p_M.shape != expected:
        raise InputError(f"method {method}: {problem.name}: predicted shape {answer.p_M.shape}, expected {expected}")
    return answer, seconds
