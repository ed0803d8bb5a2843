"""An arm type, a kind of arm, an effect and an export that are no part of cellapp."""
