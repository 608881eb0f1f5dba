"""The stage of `l3 train`, which trains a transform table from training sets, in one run or in shards."""
