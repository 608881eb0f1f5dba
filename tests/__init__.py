from l3cli.parallel import one_blas_thread

one_blas_thread()  # as the command sees to it, before numpy is imported
