"""Choice of further stops: open hypotheses, candidates, greedy selection, predicted discrimination."""
