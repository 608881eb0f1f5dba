"""The training stage: it trains a transform table from training sets, in one run or in shards."""
