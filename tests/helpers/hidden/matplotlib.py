raise ImportError("tests hide matplotlib from the processes that they start")
