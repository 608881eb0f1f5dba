"""The `l3 train` stage, which trains a transform table on training sets, in one run or in shards."""
