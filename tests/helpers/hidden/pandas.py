raise ImportError("tests hide pandas from the processes that they start")
