"""What tests share with benchmarks, which import it from here."""
