"""The whole engine on doubles of arms, tracker, air, disk, clock and person, with faults at seeded moments."""
