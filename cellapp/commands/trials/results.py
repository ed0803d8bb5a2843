"""Every result of a trial, for the exported JSON schemas."""

from __future__ import annotations

from cellapp.commands.trials.benchmark.trial import BenchmarkResult
from cellapp.commands.trials.blind_matrix import MatrixResult
from cellapp.commands.trials.check_records import CheckTrialResult
from cellapp.commands.trials.cost import CostResult
from cellapp.commands.trials.coverage import CoverageResult
from cellapp.commands.trials.judge_records import JudgeResult
from cellapp.commands.trials.league.trial import LeagueResult
from cellapp.commands.trials.paper import PaperResult
from cellapp.commands.trials.parameter_sets import ParameterSetsResult
from cellapp.commands.trials.plan_trial import PlanTrialsResult
from cellapp.commands.trials.sealed import SealResult
from cellapp.commands.trials.signature import SignatureResult
from cellapp.commands.trials.truth import TruthResult
from cellapp.ground.results import Result

TRIAL_RESULTS: tuple[type[Result], ...] = (
    CoverageResult,
    ParameterSetsResult,
    PaperResult,
    SealResult,
    JudgeResult,
    LeagueResult,
    MatrixResult,
    PlanTrialsResult,
    SignatureResult,
    CheckTrialResult,
    CostResult,
    BenchmarkResult,
    TruthResult,
)
