"""State machines as tables: power, safety, program run state; and the speed they allow."""
