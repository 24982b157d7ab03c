"""The rooms of the exam that benchmarks/exam_retrieval.py sits: keep them unread by who works on the retrieval."""
