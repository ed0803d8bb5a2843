"""The verb ``import``: a new run of readings that another program measured."""
