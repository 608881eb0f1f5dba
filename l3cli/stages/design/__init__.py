"""The design stages: scenes → moments (`moments`), a design recipe → arrays and their errors (`run`)."""
