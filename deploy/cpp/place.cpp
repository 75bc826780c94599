// Enrols photos of places, and asks where a photo was taken, with libcurl alone:
//
//     place enroll "main entrance" left.jpg right.jpg
//     place query today.jpg
//
// REVISIT_URL says where the service is (http://127.0.0.1:8000 otherwise), REVISIT_KEY is its key, if it asks for one,
// PLACE_MAP the map. Exit codes: 0 done, and for `query` the place is known; 1 it is not; 2 wrong use; 3 refused.

#include <curl/curl.h>

#include <cstdlib>
#include <iostream>
#include <memory>
#include <nlohmann/json.hpp>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

using nlohmann::json;
using Fields = std::vector<std::pair<std::string, std::string>>;

namespace {

std::string setting(const char* name, const char* otherwise) {
  const char* value = std::getenv(name);
  return value != nullptr && *value != '\0' ? value : otherwise;
}

size_t append(char* data, size_t size, size_t count, void* body) {
  static_cast<std::string*>(body)->append(data, size * count);
  return size * count;
}

// An image as multipart/form-data with some fields; the answer of the service. Throws std::runtime_error with what was
// wrong, in the words of the service where it answered.
json post(const std::string& path, const std::string& image, const Fields& fields) {
  const std::unique_ptr<CURL, decltype(&curl_easy_cleanup)> call(curl_easy_init(), curl_easy_cleanup);
  if (!call) throw std::runtime_error("libcurl cannot be initialised");
  const std::unique_ptr<curl_mime, decltype(&curl_mime_free)> form(curl_mime_init(call.get()), curl_mime_free);
  curl_mimepart* part = curl_mime_addpart(form.get());
  curl_mime_name(part, "image");
  if (curl_mime_filedata(part, image.c_str()) != CURLE_OK) throw std::runtime_error(image + " cannot be read");
  for (const auto& [name, value] : fields) {
    part = curl_mime_addpart(form.get());
    curl_mime_name(part, name.c_str());
    curl_mime_data(part, value.data(), value.size());
  }
  curl_slist* list = nullptr;
  if (const std::string key = setting("REVISIT_KEY", ""); !key.empty())
    list = curl_slist_append(list, ("Authorization: Bearer " + key).c_str());
  const std::unique_ptr<curl_slist, decltype(&curl_slist_free_all)> headers(list, curl_slist_free_all);

  std::string body, url = setting("REVISIT_URL", "http://127.0.0.1:8000") + path;
  curl_easy_setopt(call.get(), CURLOPT_URL, url.c_str());
  curl_easy_setopt(call.get(), CURLOPT_MIMEPOST, form.get());
  curl_easy_setopt(call.get(), CURLOPT_HTTPHEADER, headers.get());
  curl_easy_setopt(call.get(), CURLOPT_WRITEFUNCTION, append);
  curl_easy_setopt(call.get(), CURLOPT_WRITEDATA, &body);
  curl_easy_setopt(call.get(), CURLOPT_CONNECTTIMEOUT, 5L);
  curl_easy_setopt(call.get(), CURLOPT_TIMEOUT, 60L);
  if (const CURLcode failed = curl_easy_perform(call.get()); failed != CURLE_OK)
    throw std::runtime_error(url + ": " + curl_easy_strerror(failed));

  const json answer = json::parse(body, nullptr, false);
  long status = 0;
  curl_easy_getinfo(call.get(), CURLINFO_RESPONSE_CODE, &status);
  if (!answer.is_object()) throw std::runtime_error(url + " did not answer a JSON object: is it a revisit service?");
  // Errors are problem+json (RFC 9457): `detail` says what was wrong, `type` is for programs.
  if (status >= 400) throw std::runtime_error(answer.contains("detail") && answer["detail"].is_string()
                                                       ? answer["detail"].get<std::string>()
                                                       : body);
  return answer;
}

int enroll(const std::string& place, const std::vector<std::string>& images) {
  for (const std::string& image : images) {
    const json answer = post("/enroll", image, {{"map", setting("PLACE_MAP", "default")}, {"place", place}});
    std::cout << image << ": " << (answer.at("created").get<bool>() ? "enrolled" : "already there") << "\n";
  }
  return 0;
}

int query(const std::string& image) {
  const json answer = post("/query", image, {{"map", setting("PLACE_MAP", "default")}});
  // `matched` is right at least 97 times of 100; act on nothing else.
  if (answer.at("status") != "matched") {
    std::cout << answer.at("status").get<std::string>() << ": " << answer.at("reason").at("remedy").get<std::string>()
              << "\n";
    return 1;
  }
  const json& place = answer.at("places").at(0).at("place");
  std::cout << (place.is_null() ? "a place without a name" : place.get<std::string>()) << " ("
            << answer.at("confidence").get<double>() << ")\n";
  return 0;
}

}  // namespace

int main(int argc, char** argv) {
  const std::vector<std::string> words(argv + 1, argv + argc);
  const bool enrolling = words.size() >= 3 && words[0] == "enroll", asking = words.size() == 2 && words[0] == "query";
  if (!enrolling && !asking) {
    std::cerr << "use: place enroll PLACE IMAGE... | place query IMAGE\n";
    return 2;
  }
  curl_global_init(CURL_GLOBAL_DEFAULT);
  int code = 3;
  try {
    code = enrolling ? enroll(words[1], {words.begin() + 2, words.end()}) : query(words[1]);
  } catch (const json::exception& error) {  // of `at` and `get`: a field that every answer of revisit has is not there
    std::cerr << "place: this is no answer of a revisit service (" << error.what() << ")\n";
  } catch (const std::exception& error) {
    std::cerr << "place: " << error.what() << "\n";
  }
  curl_global_cleanup();
  return code;
}
