"""What views share: tables and charts as data, words for values."""
