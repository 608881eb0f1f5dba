from l3cli.parallel import one_blas_thread

one_blas_thread()  # like l3, before numpy is imported
