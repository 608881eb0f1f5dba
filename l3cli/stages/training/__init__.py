"""The training stage: training sets → transform table, whole (`whole`) or in shards (`shards`)."""
