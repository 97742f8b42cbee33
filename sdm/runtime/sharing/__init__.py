"""Work that several devices share: in processes of this machine, or on a Ray cluster; what is lost is a shard."""
