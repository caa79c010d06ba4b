"""State machines as tables: power, safety, and the run state of programs; and the speed scaling."""
