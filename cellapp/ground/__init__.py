"""What every group uses: errors, units, times, progress, control of jobs, outputs, tasks, the typed profile."""
