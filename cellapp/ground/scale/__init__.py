"""Many independent tasks: on the cores of this computer or on a Dask cluster, results into one store as they come."""
