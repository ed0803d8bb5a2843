"""Every result of a trial, for the exported JSON schemas."""

from __future__ import annotations

from cellapp.results import Result
from cellapp.trials.blind_matrix import MatrixResult
from cellapp.trials.bridge import BridgeResult
from cellapp.trials.campaigns.trial import CampaignsResult
from cellapp.trials.check_records import CheckTrialResult
from cellapp.trials.cost import CostResult
from cellapp.trials.coverage import CoverageResult
from cellapp.trials.judge_records import JudgeResult
from cellapp.trials.league.trial import LeagueResult
from cellapp.trials.link_results import LinksResult
from cellapp.trials.paper import PaperResult
from cellapp.trials.parameter_sets import ParameterSetsResult
from cellapp.trials.person_results import PersonResult
from cellapp.trials.plan_trial import PlanTrialsResult
from cellapp.trials.sealed import SealResult
from cellapp.trials.signature import SignatureResult
from cellapp.trials.storm import StormResult

TRIAL_RESULTS: tuple[type[Result], ...] = (
    CoverageResult,
    ParameterSetsResult,
    PaperResult,
    LinksResult,
    PersonResult,
    StormResult,
    BridgeResult,
    CampaignsResult,
    SealResult,
    JudgeResult,
    LeagueResult,
    MatrixResult,
    PlanTrialsResult,
    SignatureResult,
    CheckTrialResult,
    CostResult,
)
